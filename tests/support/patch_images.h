// Images of a textured plane, exact at every pixel.

#pragma once

#include <cmath>
#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_alignment.h"
#include "src/patches/patch_warp.h"
#include "src/util/random.h"

namespace mfir {

// Smooth texture: waves of many directions.
class WaveTexture {
 public:
  // Wavelengths between `finest` and four times as much.
  WaveTexture(double finest, uint64_t seed) {
    Random random({seed, 7});
    for (int i = 0; i < 40; ++i) {
      const double length = finest * std::pow(4.0, random.Uniform());
      const double angle = random.Uniform(0.0, 2.0 * M_PI);
      waves_.push_back({2.0 * M_PI / length * std::cos(angle),
                        2.0 * M_PI / length * std::sin(angle),
                        random.Uniform(0.0, 2.0 * M_PI)});
    }
  }

  // Grey levels, 128 +- 30.
  double Value(double x, double y) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) {
      sum += std::sin(wave.x * x + wave.y * y + wave.phase);
    }
    return 128.0 + 6.7 * sum;
  }

 private:
  struct Wave {
    double x, y, phase;
  };
  std::vector<Wave> waves_;
};

// function(x, y) at the centres of all pixels.
template <typename Function>
SplineImage RenderFunction(size_t width,
                           size_t height,
                           const Function& function) {
  std::vector<float> pixels;
  for (size_t y = 0; y < height; ++y) {
    for (size_t x = 0; x < width; ++x) {
      pixels.push_back(static_cast<float>(function(
          static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5)));
    }
  }
  return SplineImage(width, height, std::move(pixels));
}

// The plane normal . x = offset, textured by two coordinates on it.
struct TexturedPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset = 0.0;
  Eigen::Vector3d x_axis = Eigen::Vector3d::UnitX();
  WaveTexture texture;

  Eigen::Vector3d Intersect(const PatchCamera& camera,
                            const Eigen::Vector2d& xy) const {
    double uv[2];
    camera.model->Unproject(camera.params.data(), xy.x(), xy.y(), uv);
    const Eigen::Vector3d ray = camera.cam_from_world.rotation.conjugate() *
                                Eigen::Vector3d(uv[0], uv[1], 1.0);
    const Eigen::Vector3d center = camera.cam_from_world.Center();
    return center + ray * ((offset - normal.dot(center)) / normal.dot(ray));
  }

  double Value(const Eigen::Vector3d& x) const {
    return texture.Value(x.dot(x_axis), x.dot(normal.cross(x_axis)));
  }
};

template <typename Noise>
SplineImage RenderPlane(const TexturedPlane& plane,
                        const PatchCamera& camera,
                        size_t width,
                        size_t height,
                        const Noise& noise) {
  // Only the middle: the rest is not looked at.
  constexpr double kHalfSize = 110.0;
  return RenderFunction(width, height, [&](double x, double y) {
    if (std::abs(x - 0.5 * static_cast<double>(width)) > kHalfSize ||
        std::abs(y - 0.5 * static_cast<double>(height)) > kHalfSize) {
      return 128.0;
    }
    return plane.Value(plane.Intersect(camera, {x, y})) + noise();
  });
}

inline Eigen::Vector2d ProjectInto(const PatchCamera& camera,
                                   const Eigen::Vector3d& xyz) {
  const Eigen::Vector3d p = camera.cam_from_world * xyz;
  Eigen::Vector2d xy;
  camera.model->Project(
      camera.params.data(), p.x() / p.z(), p.y() / p.z(), xy.data());
  return xy;
}

// A camera at `center` that looks at the origin, y down.
inline Rigid3 LookAtOrigin(const Eigen::Vector3d& center) {
  const Eigen::Vector3d z = -center.normalized();
  const Eigen::Vector3d x = Eigen::Vector3d::UnitY().cross(z).normalized();
  Eigen::Matrix3d rotation;
  rotation << x.transpose(), z.cross(x).transpose(), z.transpose();
  Rigid3 pose;
  pose.rotation = Eigen::Quaterniond(rotation).normalized();
  pose.translation = -(pose.rotation * center);
  return pose;
}

}  // namespace mfir
