// Databases of frames: made from images, or taken as they are.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/frames/frame_features.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"

namespace mfir {

struct FrameTimings {
  double extraction = 0.0;  // seconds of wall time
  double matching = 0.0;
  double verification = 0.0;
  double triangulation = 0.0;
  double keypoints = 0.0;
};

// Writes keypoints and descriptors of the images into the new database at
// `path`. Image and camera get the id camera_idx + 1. Matches along
// epipolar lines are left to VerifyMatches; else `pairs` (indices of cameras)
// are matched by COLMAP's matcher. `progress` counts extracted images. Images
// that cannot be read are left out and reported in `warnings`. Throws
// InputError for an image whose size is not that of its camera, and if fewer
// than two images are left.
void MakeFrameDatabase(const TriangulatorOptions& options,
                       const std::vector<RigCamera>& cameras,
                       const std::vector<FrameImageFile>& files,
                       const std::vector<std::pair<size_t, size_t>>& pairs,
                       int num_threads,
                       const std::string& path,
                       const ProgressFunction& progress,
                       FrameTimings* timings,
                       std::vector<std::string>* warnings);

// Copies the database at `source` (never opened itself: COLMAP changes every
// file it opens) to `path`, with the write-ahead log beside it if there is one.
// Throws InputError if it is damaged or has no matches, or not the tables of
// this version of COLMAP, whose reader would end the program.
void CopyFrameDatabase(const std::string& source, const std::string& path);

}  // namespace mfir
