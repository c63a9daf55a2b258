#include "src/scene/view_overlap.h"

#include <algorithm>
#include <cmath>

#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr size_t kGridWidth = 8;
constexpr size_t kGridHeight = 6;
constexpr double kMinRelativeDepth = 0.125;
constexpr double kMaxRelativeDepth = 16.0;
constexpr double kDepthFactor = M_SQRT2;

// Unit vectors in the world through the centres of a grid of image cells.
std::vector<Eigen::Vector3d> GridRays(const RigCamera& camera) {
  const Eigen::Matrix3d world_from_cam =
      camera.cam_from_world.rotation.conjugate().toRotationMatrix();
  std::vector<Eigen::Vector3d> rays;
  for (size_t y = 0; y < kGridHeight; ++y) {
    for (size_t x = 0; x < kGridWidth; ++x) {
      Eigen::Vector2d uv;
      camera.model->Unproject(camera.params.data(),
                              camera.width * (x + 0.5) / kGridWidth,
                              camera.height * (y + 0.5) / kGridHeight,
                              uv.data());
      const Eigen::Vector3d ray = world_from_cam * uv.homogeneous();
      // A lens that cannot be inverted there sees nothing there.
      if (ray.allFinite()) rays.push_back(ray.normalized());
    }
  }
  return rays;
}

double Overlap(const std::vector<Eigen::Vector3d>& rays,
               const RigCamera& camera,
               const RigCamera& other,
               double depth,
               double min_cos_angle) {
  const Eigen::Vector3d center = camera.cam_from_world.Center();
  const Eigen::Vector3d other_center = other.cam_from_world.Center();
  size_t num_seen = 0;
  for (const Eigen::Vector3d& ray : rays) {
    const Eigen::Vector3d point = center + depth * ray;
    if ((point - other_center).normalized().dot(ray) < min_cos_angle) continue;
    const Eigen::Vector3d in_other = other.cam_from_world * point;
    if (in_other.z() <= 0.0) continue;
    Eigen::Vector2d xy;
    other.model->Project(other.params.data(),
                         in_other.x() / in_other.z(),
                         in_other.y() / in_other.z(),
                         xy.data());
    num_seen += xy.x() >= 0.0 && xy.y() >= 0.0 && xy.x() < other.width &&
                xy.y() < other.height;
  }
  return static_cast<double>(num_seen) / (kGridWidth * kGridHeight);
}

double RigSize(const std::vector<RigCamera>& cameras) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const RigCamera& camera : cameras) {
    mean += camera.cam_from_world.Center() / cameras.size();
  }
  double sum = 0.0;
  for (const RigCamera& camera : cameras) {
    sum += (camera.cam_from_world.Center() - mean).squaredNorm();
  }
  return std::sqrt(sum / cameras.size());
}

}  // namespace

double ViewOverlap(const RigCamera& camera,
                   const RigCamera& other,
                   double depth,
                   double max_view_angle) {
  return Overlap(GridRays(camera),
                 camera,
                 other,
                 depth,
                 std::cos(max_view_angle * M_PI / 180.0));
}

std::vector<std::pair<size_t, size_t>> SelectOverlappingPairs(
    const ViewOverlapOptions& options,
    const std::vector<RigCamera>& cameras,
    int num_threads) {
  const double rig_size = RigSize(cameras);
  if (!(rig_size > 0.0)) {
    throw InputError(
        "All cameras of RIG are at the same place: no point can be "
        "triangulated. Check the translations of --extrinsics_path.");
  }
  const double min_cos_angle = std::cos(options.max_view_angle * M_PI / 180.0);
  std::vector<std::vector<Eigen::Vector3d>> rays(cameras.size());
  ParallelFor(cameras.size(), num_threads, [&](size_t i) {
    rays[i] = GridRays(cameras[i]);
  });

  const auto overlap_anywhere = [&](size_t i, size_t j) {
    for (double depth = kMinRelativeDepth; depth <= kMaxRelativeDepth;
         depth *= kDepthFactor) {
      if (Overlap(rays[i],
                  cameras[i],
                  cameras[j],
                  depth * rig_size,
                  min_cos_angle) >= options.min_overlap) {
        return true;
      }
    }
    return false;
  };
  std::vector<std::vector<size_t>> partners(cameras.size());
  ParallelFor(cameras.size(), num_threads, [&](size_t i) {
    for (size_t j = i + 1; j < cameras.size(); ++j) {
      if (overlap_anywhere(i, j) && overlap_anywhere(j, i)) {
        partners[i].push_back(j);
      }
    }
  });
  std::vector<std::pair<size_t, size_t>> pairs;
  for (size_t i = 0; i < cameras.size(); ++i) {
    for (const size_t j : partners[i]) pairs.emplace_back(i, j);
  }
  return pairs;
}

}  // namespace mfir
