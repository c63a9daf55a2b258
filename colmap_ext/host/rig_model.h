// One reconstruction of an array of cameras and of all that it saw at several
// instants, as COLMAP's own commands take it. In COLMAP 4 the cameras are one
// rig, and the images of an instant are a frame of it; in 3.8 the images share
// the cameras, and each has its pose.

#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "colmap_ext/host/reconstruction.h"

namespace mfir::host {

// Whether models have files of rigs and frames.
inline constexpr bool kHasRigs = MFIR_COLMAP_MAJOR >= 4;

class RigModel {
 public:
  struct PosedCamera {
    Camera camera;
    Rigid3 cam_from_world;
  };

  // At least one camera; the first one is the rig's reference.
  explicit RigModel(const std::vector<PosedCamera>& cameras);

  // Adds the registered images and the points of one instant. `frame` has the
  // cameras by the same ids, at most one image of each; its intrinsics and
  // poses are left aside. Names must differ from those of all other instants.
  void AddFrame(const std::function<std::string(const Image&)>& image_name,
                const Reconstruction& frame);

  const Reconstruction& Model() const { return model_; }

 private:
  // Registered, as a frame.
  void AddImages(const std::vector<Image>& images);

  std::map<camera_t, Rigid3> cams_from_world_;
  Rigid3 rig_from_world_;  // that of the first camera
  Reconstruction model_;
};

}  // namespace mfir::host
