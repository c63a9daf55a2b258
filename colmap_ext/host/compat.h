// The only place that knows COLMAP's version: headers, poses and cameras of
// COLMAP 3.8 behind functions that other versions can offer as well.

#pragma once

#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "VLFeat/dsift.h"
#include "VLFeat/imopv.h"
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
#include "src/scene/scene.h"
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

// The nearest quaternion that COLMAP's normalization leaves as it is. COLMAP
// normalizes whenever it reads or writes one, which can change the last bits
// each time; this one comes out of every later read bit for bit.
inline Eigen::Quaterniond StableQuaternion(const Eigen::Quaterniond& q) {
  const auto is_stable = [](const Eigen::Vector4d& qvec) {
    return colmap::NormalizeQuaternion(qvec) == qvec;
  };
  Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
  for (int i = 0; i < 3 && !is_stable(qvec); ++i) {
    qvec = colmap::NormalizeQuaternion(qvec);
  }
  // About 1 % of all rotations alternate between neighbours for ever. Then a
  // component is moved by a few units in the last place.
  Eigen::Vector4d candidate = qvec;
  for (int num_ulps = 1; num_ulps <= 4 && !is_stable(candidate); ++num_ulps) {
    for (int i = 0; i < 8 && !is_stable(candidate); ++i) {
      candidate = qvec;
      for (int j = 0; j < num_ulps; ++j) {
        candidate(i / 2) =
            std::nextafter(candidate(i / 2), i % 2 == 0 ? 2.0 : -2.0);
      }
    }
  }
  return Eigen::Quaterniond(
      candidate(0), candidate(1), candidate(2), candidate(3));
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
