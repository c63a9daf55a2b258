// Matches of a frame against the known epipolar geometry.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/host/database.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"

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
  std::vector<Eigen::Vector3d> rays;  // unit, by keypoint; set by VerifyMatches
};

// Verifies the matches of the database against the epipolar geometry of
// `cameras`: their extrinsics, and the intrinsics to start from. The tolerance
// comes from the matches of each pair. Adds two-view geometries to the database
// and sets what the statistics say of matches and tolerances.
void VerifyMatches(const TriangulatorOptions& options,
                   const std::vector<RigCamera>& cameras,
                   std::vector<DatabaseImage> images,
                   int num_threads,
                   host::Database* database,
                   FrameStatistics* statistics);

// Mean of the focal lengths of both axes, pixels.
double MeanFocalLength(const RigCamera& camera);

// The value below which `share` of the values are; 0 without any.
double Quantile(std::vector<double> values, double share);

}  // namespace mfir
