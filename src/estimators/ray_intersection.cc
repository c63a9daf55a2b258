#include "src/estimators/ray_intersection.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

constexpr int kNumIterations = 10;
constexpr double kAngle = 0.01;           // rad
constexpr double kMinSquaredSine = 1e-6;  // between two rays: 0.06 degrees
constexpr size_t kMaxNumRaysForAllPairs = 6;

// Normal equations of the point closest to rays: the projector P onto the plane
// normal to each ray measures the distance, sum P (x - center) = 0.
struct RayEquations {
  Eigen::Matrix3d lhs = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();

  void Add(const Ray& ray, double weight) {
    const Eigen::Matrix3d projector =
        Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    lhs += weight * projector;
    rhs += weight * projector * ray.center;
  }

  bool Solve(Eigen::Vector3d* xyz) const {
    const Eigen::LDLT<Eigen::Matrix3d> factorization(lhs);
    if (factorization.info() != Eigen::Success) return false;
    *xyz = factorization.solve(rhs);
    return xyz->allFinite();
  }
};

bool IntersectAll(const std::vector<Ray>& rays, Eigen::Vector3d* xyz) {
  for (int iteration = 0; iteration < kNumIterations; ++iteration) {
    RayEquations equations;
    for (const Ray& ray : rays) {
      double weight = 1.0;
      if (iteration > 0) {
        const Eigen::Vector3d to_point = *xyz - ray.center;
        const double sine = ray.direction.cross(to_point).norm() /
                            std::max(to_point.norm(), 1e-300);
        weight = 1.0 / (1.0 + sine * sine / (kAngle * kAngle));
      }
      equations.Add(ray, weight);
    }
    if (!equations.Solve(xyz)) return false;
  }
  return true;
}

}  // namespace

std::vector<Eigen::Vector3d> RayIntersections(const std::vector<Ray>& rays) {
  std::vector<Eigen::Vector3d> intersections;
  Eigen::Vector3d xyz;
  if (rays.size() >= 2 && IntersectAll(rays, &xyz)) {
    intersections.push_back(xyz);
  }
  const auto add_pair = [&](const Ray& a, const Ray& b) {
    if (!(a.direction.cross(b.direction).squaredNorm() > kMinSquaredSine)) {
      return;
    }
    RayEquations equations;
    equations.Add(a, 1.0);
    equations.Add(b, 1.0);
    if (equations.Solve(&xyz)) intersections.push_back(xyz);
  };
  const size_t size = rays.size();
  for (size_t i = 0; i < size; ++i) {
    if (size > kMaxNumRaysForAllPairs) {
      add_pair(rays[i], rays[(i + size / 2) % size]);
      add_pair(rays[i], rays[(i + 1) % size]);
    } else {
      for (size_t j = i + 1; j < size; ++j) add_pair(rays[i], rays[j]);
    }
  }
  return intersections;
}

void MovePointsToTheFront(const std::vector<CameraState>& states,
                          const Scene& scene,
                          int num_threads,
                          Estimate* estimate) {
  ParallelFor(scene.frames.size(), num_threads, [&](size_t f) {
    const Frame& frame = scene.frames[f];
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      Eigen::Vector3d& xyz = estimate->frames[f].points[i];
      const auto count_in_front = [&](const Eigen::Vector3d& point) {
        size_t count = 0;
        for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
             ++k) {
          const CameraState& state =
              states[frame.images[frame.observations[k].image_idx].camera_idx];
          count +=
              state.rotation.row(2).dot(point) + state.translation.z() > 0.0;
        }
        return count;
      };
      const size_t length = frame.track_begins[i + 1] - frame.track_begins[i];
      const size_t num_in_front = count_in_front(xyz);
      if (num_in_front == length) continue;
      std::vector<Ray> rays;
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const size_t camera_idx =
            frame.images[observation.image_idx].camera_idx;
        Ray ray;
        if (UnprojectRay(*scene.cameras[camera_idx].model,
                         states[camera_idx],
                         observation.xy,
                         &ray)) {
          rays.push_back(ray);
        }
      }
      const std::vector<Eigen::Vector3d> intersections = RayIntersections(rays);
      if (!intersections.empty() &&
          count_in_front(intersections[0]) > num_in_front) {
        xyz = intersections[0];
      }
    }
  });
}

}  // namespace mfir
