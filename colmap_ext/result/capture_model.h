// OUT/model: all refined frames in one reconstruction, as COLMAP's own commands
// take it.

#pragma once

#include <set>
#include <string>
#include <vector>

#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/rig_model.h"
#include "colmap_ext/rigs/rig_io.h"

namespace mfir {

class CaptureModel {
 public:
  // Camera ids are the indices in `cameras`, which have intrinsics, + 1.
  // `image_path`: the folder of the images, empty if there is none.
  CaptureModel(const std::vector<KnownCamera>& cameras,
               const std::string& image_path);

  // Adds the frame `refined` (RefinedReconstruction). Images are named by their
  // place in the folder of images: FRAME/IMAGE_NAME, or IMAGE_NAME where they
  // lie there or come from one model of many frames.
  void AddFrame(const FrameModel& frame, const host::Reconstruction& refined);

  const host::Reconstruction& Model() const { return model_.Model(); }

 private:
  std::string ImageName(const FrameModel& frame, const std::string& name) const;

  const ImageFolder images_;
  host::RigModel model_;
  std::set<std::string> image_names_;
};

}  // namespace mfir
