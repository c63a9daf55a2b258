// Drifted intrinsics, to first order, from matches against the known epipolar
// geometry: good enough to know where to look for more matches.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/scene/scene.h"

namespace mfir {

// Two keypoints, pixels, most of which show the same point.
struct EpipolarMatch {
  size_t camera_idx1 = 0;
  size_t camera_idx2 = 0;
  Eigen::Vector2d xy1 = Eigen::Vector2d::Zero();
  Eigen::Vector2d xy2 = Eigen::Vector2d::Zero();
};

// How keypoints have to be moved so that the wrong intrinsics map them to the
// right rays: with the centre c of the image, the offset d from c and its
// length r in units of half the image diagonal,
//   xy + shift + (scale + radial r^2) d.
struct PixelDrift {
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();  // pixels
  double scale = 0.0;
  double radial = 0.0;

  Eigen::Vector2d Correct(const RigCamera& camera,
                          const Eigen::Vector2d& xy) const;
};

// Of each camera, such that signed epipolar errors (Sampson's distance, pixels)
// are smallest, robustly, with weak priors that keep zero what the matches do
// not tell. `matches` whose epipolar error is not defined have no effect.
std::vector<PixelDrift> EstimateEpipolarDrift(
    const std::vector<RigCamera>& cameras,
    const std::vector<EpipolarMatch>& matches);

}  // namespace mfir
