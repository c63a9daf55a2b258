// Features of the images of a frame and their matches, by COLMAP's extractors
// and matchers.

#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/host/feature.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"
#include "src/util/progress.h"

namespace mfir {

// An image file of a frame.
struct FrameImageFile {
  size_t camera_idx = 0;  // into the cameras of the rig
  std::string name;       // relative to the frame's folder
  std::string path;
  std::string mask_path;  // empty: none
};

struct FrameFeatures {
  size_t camera_idx = 0;
  std::string name;
  std::shared_ptr<host::FeatureKeypoints> keypoints;
  std::shared_ptr<host::FeatureDescriptors> descriptors;
};

// By camera. Images that cannot be read are left out and reported in
// `warnings`. Throws InputError for an image whose size is not that of its
// camera, and for masks that cannot be read or have another size. `progress`
// counts images.
std::vector<FrameFeatures> ExtractFeatures(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<FrameImageFile>& files,
    int num_threads,
    const ProgressFunction& progress,
    std::vector<std::string>* warnings);

struct FrameMatches {
  size_t camera_idx1 = 0;
  size_t camera_idx2 = 0;
  host::FeatureMatches matches;
};

// Of those of the pairs of cameras that have features. In the order of the
// cameras.
std::vector<FrameMatches> MatchFeatures(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<FrameFeatures>& features,
    const std::vector<std::pair<size_t, size_t>>& pairs,
    int num_threads);

}  // namespace mfir
