// The only place that knows COLMAP's version: headers, poses and cameras of
// COLMAP 3.8 behind functions that other versions can offer as well.

#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/camera_models.h"
#include "base/cost_functions.h"
#include "base/database.h"
#include "base/database_cache.h"
#include "base/essential_matrix.h"
#include "base/image.h"
#include "base/pose.h"
#include "base/reconstruction.h"
#include "base/similarity_transform.h"
#include "exe/extension.h"
#include "optim/bundle_adjustment.h"
#include "sfm/incremental_mapper.h"
#include "src/scene.h"
#include "util/bitmap.h"
#include "util/cuda.h"
#include "util/logging.h"
#include "util/misc.h"
#include "util/option_manager.h"
#include "util/random.h"
#include "util/version.h"

// util/opengl_utils.h has unused parameters where OpenGL is off.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#include "feature/extraction.h"
#include "feature/matching.h"
#pragma GCC diagnostic pop

namespace mfir {

// cam_from_world of an image, the stored doubles unchanged.
inline Rigid3 CamFromWorld(const colmap::Image& image) {
  const Eigen::Vector4d& qvec = image.Qvec();
  return {Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3)), image.Tvec()};
}

// Stores the doubles of `cam_from_world` unchanged (no normalization).
inline void SetCamFromWorld(const Rigid3& cam_from_world,
                            colmap::Image* image) {
  const Eigen::Quaterniond& q = cam_from_world.rotation;
  image->SetQvec(Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()));
  image->SetTvec(cam_from_world.translation);
}

// COLMAP normalizes quaternions whenever it reads or writes them, which can
// change the last bit each time. This one stays what it is: the pose that a
// solve is pinned to comes out of every later read bit for bit.
inline Eigen::Quaterniond StableQuaternion(const Eigen::Quaterniond& q) {
  Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
  for (int i = 0; i < 10; ++i) {
    const Eigen::Vector4d normalized = colmap::NormalizeQuaternion(qvec);
    if (normalized == qvec) break;
    qvec = normalized;
  }
  return Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3));
}

// Whether COLMAP's SIFT can run on a GPU here. Its OpenGL variant needs a
// window system and the main thread, and is not used.
inline bool HasGpuSift() {
#ifdef CUDA_ENABLED
  return colmap::GetNumCudaDevices() > 0;
#else
  return false;
#endif
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
