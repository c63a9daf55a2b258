// RootSIFT descriptors at every pixel of the patches.

#pragma once

#include <string>

#include "colmap_ext/feature/image_folder.h"
#include "src/dense/dense_feature_options.h"
#include "src/dense/dense_features.h"

namespace mfir {

// 128 channels of unit length, zero where the image is constant: upright SIFT
// descriptors by VLFeat's dense SIFT (flat window) on the smoothed grey image,
// as square roots of their L1-normalized values (Arandjelovic and Zisserman,
// "Three things everyone should know to improve object retrieval", 2012).
// Beyond the image's border its border pixels are repeated.
class SiftFeatureSource : public DenseFeatureSource {
 public:
  SiftFeatureSource(const SiftFeatureOptions& options,
                    int patch_size,
                    int num_threads,
                    const std::string& image_path);

  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override;
  bool ReadSiftImage(const DenseFeatureRequest& request,
                     SiftImage* image,
                     DenseFeaturePatches* patches) override;

 private:
  const SiftFeatureOptions options_;
  const int patch_size_;
  const int num_threads_;
  const ImageFolder images_;
};

}  // namespace mfir
