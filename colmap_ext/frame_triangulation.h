// From the matches of a frame to its sparse model, with known extrinsics.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/compat.h"
#include "colmap_ext/frame_database.h"
#include "colmap_ext/triangulator_options.h"
#include "src/camera_naming.h"
#include "src/scene.h"

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

// Triangulates the frame whose database lies at `database_path`. Matches that
// have no two-view geometries yet are verified against the epipolar geometry of
// `cameras` (their extrinsics, and the intrinsics to start from), and these are
// added to the database. Images are found in the database by camera name; those
// without camera of the rig are left out and reported in `warnings`.
//
// The model has one camera per image, id = index into `cameras` + 1.
// Throws InputError: fewer than two images, two images of a camera, image sizes
// that are not those of the cameras, no verified pair, no point.
colmap::Reconstruction TriangulateFrame(const TriangulatorOptions& options,
                                        const CameraNaming& naming,
                                        const std::vector<RigCamera>& cameras,
                                        int num_threads,
                                        const std::string& database_path,
                                        FrameStatistics* statistics,
                                        FrameTimings* timings,
                                        std::vector<std::string>* warnings);

}  // namespace mfir
