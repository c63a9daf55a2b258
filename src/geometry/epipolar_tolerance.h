// Matches against the known epipolar geometry, where the intrinsics have
// drifted: how far from their epipolar lines are the right ones?

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/geometry/rigid3.h"

namespace mfir {

// E with ray2^T E ray1 = 0 for the rays (camera coordinates) of a point.
Eigen::Matrix3d EssentialMatrix(const Rigid3& cam1_from_world,
                                const Rigid3& cam2_from_world);

// Sampson's distance in pixels on the viewing sphere, so that it holds for all
// lenses: the smallest displacement of both keypoints, together, that puts the
// unit rays on corresponding epipolar lines. `focal_length1`, `focal_length2`
// are pixels per radian.
double EpipolarError(const Eigen::Matrix3d& essential_matrix,
                     const Eigen::Vector3d& ray1,
                     const Eigen::Vector3d& ray2,
                     double focal_length1,
                     double focal_length2);

struct EpipolarTolerance {
  // Matches within are taken for right ones.
  double tolerance = 0.0;  // pixels
  size_t num_inliers = 0;
  // ln of the number of false alarms: how many sets of so many matches within
  // the tolerance are expected among wrong matches only.
  double log_nfa = 0.0;
};

// The tolerance for one image pair, from the epipolar errors of its matches
// alone: of all sets of the k matches with the smallest errors, the one that
// would be most surprising if all matches were wrong, i.e. with the smallest
//   NFA(k) = C(n, k) (share * e_k / max_error)^k
// (a contrario, Moisan & Stival, "A Probabilistic Criterion to Detect Rigid
// Point Matches", IJCV 2004), e_k then widened such that the tail of the right
// matches is kept. Drift makes errors of right matches large and of one sign,
// which does not matter here.
//
//   errors           pixels; those above max_error count as wrong matches
//   share            of random pairs of keypoints with errors below max_error
//   min_error        pixels; noise of the keypoints, e_k is at least this
EpipolarTolerance EstimateEpipolarTolerance(std::vector<double> errors,
                                            double share,
                                            double min_error,
                                            double max_error);

// ln NFA of k of n matches within `tolerance`.
double LogNumFalseAlarms(
    size_t n, size_t k, double tolerance, double share, double max_error);

}  // namespace mfir
