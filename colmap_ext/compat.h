// The only place that knows COLMAP's version: headers, poses and cameras of
// COLMAP 3.8 behind functions that other versions can offer as well.

#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/camera_models.h"
#include "base/image.h"
#include "base/reconstruction.h"
#include "base/similarity_transform.h"
#include "exe/extension.h"
#include "optim/bundle_adjustment.h"
#include "src/scene.h"
#include "util/bitmap.h"
#include "util/logging.h"
#include "util/misc.h"
#include "util/option_manager.h"
#include "util/version.h"

namespace mfir {

// cam_from_world of an image, the stored doubles unchanged.
inline Rigid3 CamFromWorld(const colmap::Image& image) {
  const Eigen::Vector4d& qvec = image.Qvec();
  return {Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3)),
          image.Tvec()};
}

// Stores the doubles of `cam_from_world` unchanged (no normalization).
inline void SetCamFromWorld(const Rigid3& cam_from_world,
                            colmap::Image* image) {
  const Eigen::Quaterniond& q = cam_from_world.rotation;
  image->SetQvec(Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()));
  image->SetTvec(cam_from_world.translation);
}

// Applies new_from_old to all poses and points.
inline void TransformReconstruction(const Similarity3& new_from_old,
                                    colmap::Reconstruction* reconstruction) {
  const Eigen::Quaterniond& q = new_from_old.rotation;
  reconstruction->Transform(
      colmap::SimilarityTransform3(new_from_old.scale,
                                   Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()),
                                   new_from_old.translation));
}

}  // namespace mfir
