// The object of simulated captures: a head-like, textured surface that deforms
// over the frames.

#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

namespace mfir {

// Star-shaped around the origin: an ellipsoid with smooth bumps whose heights
// change from frame to frame. World axes as in a head and shoulders image: x
// right, y down, the face looks to -z.
class SyntheticSurface {
 public:
  // The surface of one instant.
  //
  //   seed             decides on the bumps and the texture.
  //   frame            index of the instant.
  //   unit             world units per metre; the head is 0.24 m tall.
  //   finest_texture   size of the texture's finest structures, world units.
  //   gloss            brightness of reflections at their brightest, [0, 1].
  SyntheticSurface(uint64_t seed,
                   size_t frame,
                   double unit,
                   double finest_texture,
                   double gloss = 0.0);

  // Distance of the surface from the origin (world units) in the unit
  // direction `direction`.
  double Radius(const Eigen::Vector3d& direction) const;

  // Outward unit normal at the surface point in the unit direction `direction`.
  Eigen::Vector3d Normal(const Eigen::Vector3d& direction) const;

  // Reflectance in [0, 1] at a unit direction. Tied to the undeformed surface,
  // so that the texture moves with the deformation.
  double Albedo(const Eigen::Vector3d& direction) const;

  // Brightness in [0, 1] at a unit direction: albedo under a fixed light, the
  // same from every side (Lambert).
  double Brightness(const Eigen::Vector3d& direction) const;

  // What `gloss` adds to it as seen along the unit vector `ray`: the mirror
  // image of lamps all around. It wanders over the surface with the camera.
  double Reflection(const Eigen::Vector3d& direction,
                    const Eigen::Vector3d& ray) const;

  // Distance (world units) along the unit vector `ray` from `origin`, outside
  // of the surface, to the first intersection.
  std::optional<double> Intersect(const Eigen::Vector3d& origin,
                                  const Eigen::Vector3d& ray) const;

  // The same from a distance that is wrong by less than a few hundredths of the
  // surface's size; much faster.
  double RefineIntersection(const Eigen::Vector3d& origin,
                            const Eigen::Vector3d& ray,
                            double distance) const;

 private:
  static constexpr int kNumBumps = 32;
  using BumpArray = Eigen::Array<double, kNumBumps, 1>;

  // Radius as a multiple of the ellipsoid's.
  double Height(const Eigen::Vector3d& direction) const;

  // Zero on the surface, positive outside, in units of the semi-axes.
  double SignedDistance(const Eigen::Vector3d& x) const;

  Eigen::Vector3d axes_;  // semi-axes of the ellipsoid, world units
  // Bump: amplitude * max(0, 1 - (1 - direction . centre) / width)^3.
  Eigen::Matrix<double, kNumBumps, 3> centers_;
  BumpArray inverse_widths_;
  BumpArray amplitudes_;
  // Bounds of Height over all directions.
  double min_height_;
  double max_height_;

  uint64_t texture_seed_;
  double finest_texture_;  // world units
  double gloss_;
};

}  // namespace mfir
