// Matches of a frame along the known epipolar geometry, or verified against it.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/host/database.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"
#include "src/util/progress.h"

namespace mfir {

struct FrameStatistics {
  size_t num_images = 0;
  size_t num_pairs = 0;  // verified
  size_t num_matches = 0;
  size_t num_inlier_matches = 0;
  // Epipolar tolerance, pixels: median and 90 % quantile over the pairs.
  double median_tolerance = 0.0;
  double large_tolerance = 0.0;
  size_t num_points = 0;
  size_t num_observations = 0;
};

// An image of the database that belongs to a camera of the rig.
struct DatabaseImage {
  host::image_t image_id = 0;
  std::string name;
  size_t camera_idx = 0;
};

// Matches the images along the epipolar lines of `cameras`: their extrinsics,
// and the intrinsics to start from. How far right matches are from these lines
// is estimated for each pair from a sample of the keypoints.
//
// The pairs are those with matches in the database, or, if it has none,
// `camera_pairs`; then the new matches are added. Pairs without SIFT
// descriptors, and all without options.feature_matching.guided_matching, keep
// the matches of the database that agree with the epipolar geometry; so do
// those that have more of these.
//
// Adds two-view geometries to the database, and sets what the statistics say of
// matches and tolerances. `progress` counts pairs.
void VerifyMatches(const TriangulatorOptions& options,
                   const std::vector<RigCamera>& cameras,
                   const std::vector<DatabaseImage>& images,
                   const std::vector<std::pair<size_t, size_t>>& camera_pairs,
                   int num_threads,
                   const ProgressFunction& progress,
                   host::Database* database,
                   FrameStatistics* statistics);

// Mean of the focal lengths of both axes, pixels.
double MeanFocalLength(const RigCamera& camera);

// The value below which `share` of the values are; 0 without any.
double Quantile(std::vector<double> values, double share);

}  // namespace mfir
