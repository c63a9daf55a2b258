#include "src/simulation/synthetic_surface.h"

#include <algorithm>
#include <cmath>

#include "src/util/random.h"

namespace mfir {
namespace {

struct Bump {
  double center[3];
  double width;
  double amplitude;
};

// What makes an ellipsoid a head; the other bumps are random.
constexpr Bump kFace[] = {
    {{0.00, 0.12, -1.0}, 0.035, 0.17},    // nose
    {{0.36, -0.12, -1.0}, 0.050, -0.08},  // eye sockets
    {{-0.36, -0.12, -1.0}, 0.050, -0.08},
    {{0.00, 0.80, -1.0}, 0.080, 0.08},  // chin
    {{0.00, 0.48, -1.0}, 0.022, 0.05},  // mouth
    {{1.00, 0.08, 0.15}, 0.040, 0.12},  // ears
    {{-1.00, 0.08, 0.15}, 0.040, 0.12},
    {{0.00, -0.45, -1.0}, 0.150, 0.05},  // forehead
};
constexpr int kNumFaceBumps = sizeof(kFace) / sizeof(kFace[0]);

constexpr uint64_t kShapeStream = 1;
constexpr uint64_t kTextureStream = 2;
constexpr uint64_t kLampStream = 3;

double Fade(double t) { return t * t * t * (t * (t * 6.0 - 15.0) + 10.0); }

// Lattice coordinate as 21 bits: far more cells than any object has.
uint64_t CellKey(int64_t cell) {
  return static_cast<uint64_t>(cell) & 0x1fffff;
}

// Gradient noise (Perlin), about [-1, 1], with structures of size 1.
double GradientNoise(uint64_t seed, const Eigen::Vector3d& x) {
  int64_t cell[3];
  double offset[3];
  double weights[3][2];
  for (int i = 0; i < 3; ++i) {
    cell[i] = static_cast<int64_t>(x(i)) - (x(i) < 0.0);  // rounds down
    offset[i] = x(i) - static_cast<double>(cell[i]);
    weights[i][1] = Fade(offset[i]);
    weights[i][0] = 1.0 - weights[i][1];
  }
  double sum = 0.0;
  for (int corner = 0; corner < 8; ++corner) {
    const int dx = corner & 1, dy = (corner >> 1) & 1, dz = corner >> 2;
    const uint64_t hash = Random::Mix(seed ^ (CellKey(cell[0] + dx) << 42 |
                                              CellKey(cell[1] + dy) << 21 |
                                              CellKey(cell[2] + dz)));
    // Three bytes of the hash are a gradient in [-127.5, 127.5]^3.
    const double value =
        (static_cast<int>(hash & 0xff) - 127.5) * (offset[0] - dx) +
        (static_cast<int>((hash >> 8) & 0xff) - 127.5) * (offset[1] - dy) +
        (static_cast<int>((hash >> 16) & 0xff) - 127.5) * (offset[2] - dz);
    sum += value * weights[0][dx] * weights[1][dy] * weights[2][dz];
  }
  return sum / 127.5;
}

}  // namespace

SyntheticSurface::SyntheticSurface(uint64_t seed,
                                   size_t frame,
                                   double unit,
                                   double finest_texture,
                                   double gloss)
    : axes_(unit * Eigen::Vector3d(0.085, 0.120, 0.100)),
      texture_seed_(Random::Mix(seed ^ Random::Mix(kTextureStream))),
      finest_texture_(finest_texture),
      gloss_(gloss) {
  Random random({seed, kShapeStream});
  for (int i = 0; i < kNumBumps; ++i) {
    Eigen::Vector3d center{random.Normal(), random.Normal(), random.Normal()};
    double width = 1.0 / random.Uniform(2.0, 12.0);
    double amplitude = std::clamp(random.Normal(0.0, 0.03), -0.06, 0.06);
    const double phase = random.Uniform(0.0, 2.0 * M_PI);
    const double speed = random.Uniform(0.2, 1.0);
    double change = 0.7 + 0.5 * std::sin(phase + speed * frame);
    if (i < kNumFaceBumps) {
      center = Eigen::Vector3d(kFace[i].center);
      width = kFace[i].width;
      amplitude = kFace[i].amplitude;
      change = 1.0 + 0.2 * std::sin(phase + speed * frame);
    }
    centers_.row(i) = center.normalized();
    inverse_widths_(i) = 1.0 / width;
    amplitudes_(i) = amplitude * change;
  }

  // Extrema over a Fibonacci lattice of directions, much denser than the bumps
  // are wide; the margin covers what lies between its nodes.
  constexpr int kNumDirections = 20000;
  constexpr double kMargin = 0.01;
  min_height_ = 1.0;
  max_height_ = 1.0;
  for (int i = 0; i < kNumDirections; ++i) {
    const double y = 1.0 - (2.0 * i + 1.0) / kNumDirections;
    const double azimuth = i * M_PI * (3.0 - std::sqrt(5.0));
    const double radius = std::sqrt(1.0 - y * y);
    const double height = Height(Eigen::Vector3d(
        radius * std::cos(azimuth), y, radius * std::sin(azimuth)));
    min_height_ = std::min(min_height_, height);
    max_height_ = std::max(max_height_, height);
  }
  min_height_ -= kMargin;
  max_height_ += kMargin;
}

double SyntheticSurface::Height(const Eigen::Vector3d& direction) const {
  const BumpArray cosines = (centers_ * direction).array();
  const BumpArray t = (1.0 - (1.0 - cosines) * inverse_widths_).max(0.0);
  return 1.0 + (amplitudes_ * t * t * t).sum();
}

double SyntheticSurface::SignedDistance(const Eigen::Vector3d& x) const {
  return x.cwiseQuotient(axes_).norm() - Height(x.normalized());
}

double SyntheticSurface::Radius(const Eigen::Vector3d& direction) const {
  return Height(direction) / direction.cwiseQuotient(axes_).norm();
}

Eigen::Vector3d SyntheticSurface::Normal(
    const Eigen::Vector3d& direction) const {
  // Gradient of |x / axes| - Height(x / |x|) at the surface point.
  const Eigen::Vector3d scaled = direction.cwiseQuotient(axes_);
  const BumpArray cosines = (centers_ * direction).array();
  const BumpArray t = (1.0 - (1.0 - cosines) * inverse_widths_).max(0.0);
  const BumpArray slopes = 3.0 * amplitudes_ * t * t * inverse_widths_;
  const Eigen::Vector3d height_gradient =
      centers_.transpose() * slopes.matrix();
  const Eigen::Vector3d tangential =
      height_gradient - height_gradient.dot(direction) * direction;
  return (scaled.cwiseQuotient(axes_) / scaled.norm() -
          tangential / Radius(direction))
      .normalized();
}

double SyntheticSurface::Albedo(const Eigen::Vector3d& direction) const {
  // The texture is solid noise cut by the undeformed ellipsoid.
  const Eigen::Vector3d x = direction / direction.cwiseQuotient(axes_).norm();
  constexpr int kNumOctaves = 5;
  double sum = 0.0;
  double size = finest_texture_;
  for (int octave = 0; octave < kNumOctaves; ++octave) {
    sum += GradientNoise(texture_seed_ + octave, x / size);
    size *= 2.0;
  }
  constexpr double kContrast = 0.9;
  return 0.5 + 0.5 * std::tanh(kContrast * sum);
}

double SyntheticSurface::Brightness(const Eigen::Vector3d& direction) const {
  static const Eigen::Vector3d kLight =
      Eigen::Vector3d(-0.3, -0.6, -1.0).normalized();
  // Ambient light and a soft lamp from above the face.
  const double shading = 0.75 + 0.25 * Normal(direction).dot(kLight);
  return (0.12 + 0.83 * Albedo(direction)) * shading;
}

double SyntheticSurface::Reflection(const Eigen::Vector3d& direction,
                                    const Eigen::Vector3d& ray) const {
  if (gloss_ == 0.0) return 0.0;
  // Lamps: the bright half of noise over directions, some degrees wide.
  constexpr double kLampSize = 0.15;
  const Eigen::Vector3d normal = Normal(direction);
  const Eigen::Vector3d mirrored = ray - 2.0 * ray.dot(normal) * normal;
  const double lamps =
      GradientNoise(texture_seed_ ^ kLampStream, mirrored / kLampSize);
  return gloss_ * std::clamp(lamps, 0.0, 1.0);
}

std::optional<double> SyntheticSurface::Intersect(
    const Eigen::Vector3d& origin, const Eigen::Vector3d& ray) const {
  // In the coordinates x / axes the ellipsoid is a sphere. The surface lies
  // between the spheres of radius min_height_ and max_height_.
  const Eigen::Vector3d a = origin.cwiseQuotient(axes_);
  const Eigen::Vector3d b = ray.cwiseQuotient(axes_);
  const double bb = b.squaredNorm();
  const double t_middle = -a.dot(b) / bb;
  const double closest2 = (a + t_middle * b).squaredNorm();
  const double outer2 = max_height_ * max_height_ - closest2;
  if (outer2 <= 0.0) {
    return std::nullopt;
  }
  const double half_length = std::sqrt(outer2 / bb);
  const double t_end = t_middle + half_length;
  const auto signed_distance = [&](double t) {
    return SignedDistance(origin + t * ray);
  };

  // March with steps that the slope of the surface allows. What the smallest
  // step may miss is a graze far thinner than a pixel.
  const double max_slope_step = 0.8 * axes_.minCoeff();
  const double min_step = 0.02 * axes_.minCoeff();
  double t0 = t_middle - half_length;
  double f0 = signed_distance(t0);
  double t1 = t0;
  double f1 = f0;
  while (f1 > 0.0) {
    t0 = t1;
    f0 = f1;
    if (t0 >= t_end) {
      return std::nullopt;
    }
    t1 = t0 + std::max(max_slope_step * f0, min_step);
    f1 = signed_distance(t1);
  }

  // Regula falsi with the Illinois rule inside of the bracket [t0, t1].
  constexpr double kTolerance = 1e-10;  // of the semi-axes
  constexpr int kMaxNumIterations = 50;
  for (int i = 0; i < kMaxNumIterations; ++i) {
    const double t = t1 - f1 * (t1 - t0) / (f1 - f0);
    const double f = signed_distance(t);
    if (std::abs(f) < kTolerance) {
      return t;
    }
    if (f > 0.0) {
      t0 = t;
      f0 = f;
      f1 *= 0.5;
    } else {
      t1 = t;
      f1 = f;
      f0 *= 0.5;
    }
  }
  return 0.5 * (t0 + t1);
}

double SyntheticSurface::RefineIntersection(const Eigen::Vector3d& origin,
                                            const Eigen::Vector3d& ray,
                                            double distance) const {
  // One Newton step; over this length the surface is flat.
  const double delta = 1e-4 * axes_.minCoeff();
  const double f = SignedDistance(origin + distance * ray);
  const double f_before = SignedDistance(origin + (distance - delta) * ray);
  return distance - f * delta / (f - f_before);
}

}  // namespace mfir
