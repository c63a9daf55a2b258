#include "src/refinement/initial_intrinsics.h"

#include <algorithm>
#include <utility>

#include <Eigen/Core>

#include "src/util/median.h"

namespace mfir {
namespace {

// Whether pixels at half of the shorter side from the principal point stay
// between 0.3 and 3 times that far from it. (A fisheye lens of 220 degrees has
// 0.57.)
bool IsDistortionPlausible(const RigCamera& camera,
                           const std::vector<double>& params) {
  const std::vector<size_t>& pp_idxs = camera.model->PrincipalPointIdxs();
  const Eigen::Vector2d principal_point(params[pp_idxs[0]], params[pp_idxs[1]]);
  const double focal_length = params[camera.model->FocalLengthIdxs()[0]];
  const double radius =
      0.5 * static_cast<double>(std::min(camera.width, camera.height));
  const double uv = radius / focal_length;
  for (const auto& [u, v] : {std::pair(uv, 0.0),
                             std::pair(-uv, 0.0),
                             std::pair(0.0, uv),
                             std::pair(0.0, -uv)}) {
    Eigen::Vector2d xy;
    camera.model->Project(params.data(), u, v, xy.data());
    const double ratio = (xy - principal_point).norm() / radius;
    if (!(ratio >= 0.3 && ratio <= 3.0)) return false;
  }
  return true;
}

// COLMAP's limits of what is no bogus camera, but for distortion, which COLMAP
// judges by the size of its parameters. Structure from motion with few images
// of a camera ends anywhere.
bool IsPlausible(const RigCamera& camera, const std::vector<double>& params) {
  const double max_size =
      static_cast<double>(std::max(camera.width, camera.height));
  for (const size_t idx : camera.model->FocalLengthIdxs()) {
    const double ratio = params[idx] / max_size;
    if (!(ratio >= 0.1 && ratio <= 10.0)) return false;
  }
  const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
  return params[idxs[0]] >= 0.0 && params[idxs[0]] <= camera.width &&
         params[idxs[1]] >= 0.0 && params[idxs[1]] <= camera.height &&
         IsDistortionPlausible(camera, params);
}

// The array's plausible cameras of the same model and image size.
std::vector<const RigCamera*> FindPeers(const std::vector<RigCamera>& cameras,
                                        const RigCamera& camera) {
  std::vector<const RigCamera*> peers;
  for (const RigCamera& other : cameras) {
    if (other.model == camera.model && other.width == camera.width &&
        other.height == camera.height && IsPlausible(other, other.params)) {
      peers.push_back(&other);
    }
  }
  return peers;
}

// The medians of the plausible images only. A camera without any gets focal
// lengths and distortion from the array's other cameras, and the image centre.
std::vector<RigCamera> ReplaceImplausibleIntrinsics(
    const Scene& scene,
    const std::vector<FrameEstimate>& frames,
    std::vector<RigCamera> cameras) {
  Scene plausible_scene;
  plausible_scene.ranks = scene.ranks;
  std::vector<FrameEstimate> plausible_frames;
  for (size_t f = 0; f < frames.size(); ++f) {
    plausible_scene.frames.emplace_back();
    plausible_frames.emplace_back();
    for (size_t i = 0; i < frames[f].images.size(); ++i) {
      const FrameImage& image = scene.frames[f].images[i];
      const ImageEstimate& estimate = frames[f].images[i];
      if (!IsPlausible(cameras[image.camera_idx], estimate.params)) {
        continue;
      }
      plausible_scene.frames.back().images.push_back(image);
      plausible_frames.back().images.push_back(estimate);
    }
  }
  cameras = WithMedianIntrinsics(
      plausible_scene, plausible_frames, std::move(cameras));
  const std::vector<RigCamera> medians = cameras;
  for (RigCamera& camera : cameras) {
    if (camera.model == nullptr || IsPlausible(camera, camera.params)) continue;
    const std::vector<const RigCamera*> peers = FindPeers(medians, camera);
    for (size_t j = 0; !peers.empty() && j < camera.params.size(); ++j) {
      std::vector<double> values;
      for (const RigCamera* peer : peers) values.push_back(peer->params[j]);
      camera.params[j] = Median(values);
    }
    const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
    camera.params[idxs[0]] = 0.5 * static_cast<double>(camera.width);
    camera.params[idxs[1]] = 0.5 * static_cast<double>(camera.height);
  }
  return cameras;
}

}  // namespace

std::vector<RigCamera> WithMedianIntrinsics(
    const Scene& scene,
    const std::vector<FrameEstimate>& frames,
    std::vector<RigCamera> cameras) {
  struct Param {
    size_t camera_idx;
    size_t idx;
    double value;
  };
  std::vector<Param> params;
  for (size_t f = 0; f < frames.size(); ++f) {
    for (size_t i = 0; i < frames[f].images.size(); ++i) {
      const std::vector<double>& values = frames[f].images[i].params;
      for (size_t j = 0; j < values.size(); ++j) {
        params.push_back({scene.frames[f].images[i].camera_idx, j, values[j]});
      }
    }
  }
  std::vector<std::vector<std::vector<double>>> values(cameras.size());
  for (size_t c = 0; c < cameras.size(); ++c) {
    if (cameras[c].model == nullptr) continue;
    cameras[c].params.resize(cameras[c].model->NumParams());
    values[c].resize(cameras[c].params.size());
  }
  for (const Param& param : Concatenate(*scene.ranks, params)) {
    std::vector<std::vector<double>>& camera_values = values[param.camera_idx];
    if (param.idx >= camera_values.size()) continue;  // without a model
    camera_values[param.idx].push_back(param.value);
  }
  for (size_t c = 0; c < cameras.size(); ++c) {
    for (size_t j = 0; j < values[c].size(); ++j) {
      if (!values[c][j].empty()) cameras[c].params[j] = Median(values[c][j]);
    }
  }
  return cameras;
}

SceneEstimate InitializeIntrinsics(const MultiFrameOptions& options,
                                   SceneEstimate capture) {
  Scene& scene = capture.scene;
  std::vector<FrameEstimate>& frames = capture.estimate.frames;
  scene.cameras = ReplaceImplausibleIntrinsics(
      scene, frames, WithMedianIntrinsics(scene, frames, scene.cameras));
  capture.estimate.cameras = scene.cameras;
  for (size_t f = 0; f < frames.size(); ++f) {
    for (size_t i = 0; i < frames[f].images.size(); ++i) {
      std::vector<double>& params = frames[f].images[i].params;
      const RigCamera& camera =
          scene.cameras[scene.frames[f].images[i].camera_idx];
      const auto hold = [&](bool refine, const std::vector<size_t>& idxs) {
        for (const size_t idx : idxs) {
          if (!refine) params[idx] = camera.params[idx];
        }
      };
      if (camera.constant_intrinsics) params = camera.params;
      hold(options.refine_focal_length, camera.model->FocalLengthIdxs());
      hold(options.refine_principal_point, camera.model->PrincipalPointIdxs());
      hold(options.refine_extra_params, camera.model->ExtraParamsIdxs());
    }
  }
  return capture;
}

}  // namespace mfir
