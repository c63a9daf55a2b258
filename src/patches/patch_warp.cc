#include "src/patches/patch_warp.h"

#include <cmath>

namespace mfir {
namespace {

// Of the points in front of a camera, relative to their distance from the other
// camera.
constexpr double kMinDepth = 1e-3;

// Rotation and translation from the reference camera to another.
struct RelativePose {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
};

RelativePose MakeRelativePose(const ReferencePatch& reference,
                              const PatchCamera& camera) {
  const Eigen::Quaterniond rotation =
      camera.cam_from_world.rotation *
      reference.cam_from_world.rotation.conjugate();
  return {rotation.toRotationMatrix(),
          camera.cam_from_world.translation -
              rotation * reference.cam_from_world.translation};
}

// Pixel of the surface point on a ray, both divided by its depth in the
// reference camera.
bool ProjectRay(const RelativePose& pose,
                const PatchCamera& camera,
                const Eigen::Vector3d& ray,
                double inverse_depth,
                Eigen::Vector2d* xy) {
  const Eigen::Vector3d p =
      pose.rotation * ray + pose.translation * inverse_depth;
  if (!(p.z() > kMinDepth)) return false;
  camera.model->Project(
      camera.params.data(), p.x() / p.z(), p.y() / p.z(), xy->data());
  return xy->allFinite();
}

// d(pixel) / d(ray) of a lens at a ray.
Eigen::Matrix2d LensJacobian(const PatchCamera& camera,
                             double x,
                             double y,
                             Eigen::Vector2d* xy) {
  std::vector<double> jacobian_params(2 * camera.model->NumParams());
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian;
  camera.model->ProjectWithJacobian(camera.params.data(),
                                    x,
                                    y,
                                    xy->data(),
                                    jacobian.data(),
                                    jacobian_params.data());
  return jacobian;
}

}  // namespace

Eigen::Vector2d ReferencePatch::FacingSlope() const {
  return SlopeOfTilt(*this, Eigen::Vector2d::Zero());
}

bool MakeReferencePatch(const PatchCamera& camera,
                        const Eigen::Vector2d& xy,
                        ReferencePatch* reference) {
  constexpr double kMaxError = 0.01;  // px
  reference->cam_from_world = camera.cam_from_world;
  for (int i = 0; i < 9; ++i) {
    double uv[2];
    camera.model->Unproject(camera.params.data(),
                            xy.x() + kRayStep * (i % 3 - 1),
                            xy.y() + kRayStep * (i / 3 - 1),
                            uv);
    reference->rays[i] = Eigen::Vector3d(uv[0], uv[1], 1.0);
  }
  Eigen::Vector2d back;
  const Eigen::Matrix2d jacobian =
      LensJacobian(camera, reference->Ray().x(), reference->Ray().y(), &back);
  // The inverse of a lens model may not have converged.
  if (!((back - xy).norm() < kMaxError) || !(jacobian.determinant() > 0.0)) {
    return false;
  }
  reference->ray_jacobian = jacobian.inverse();
  return reference->ray_jacobian.allFinite();
}

Eigen::Vector2d SlopeOfTilt(const ReferencePatch& reference,
                            const Eigen::Vector2d& tangent) {
  const Eigen::Vector3d ray = reference.Ray();
  const Eigen::Quaterniond turn = Eigen::Quaterniond::FromTwoVectors(
      Eigen::Vector3d::UnitZ(), ray.normalized());
  const Eigen::Vector3d normal =
      turn * Eigen::Vector3d(tangent.x(), tangent.y(), 1.0);
  // normal . ray / depth is the same for all points of the plane.
  return reference.ray_jacobian.transpose() * normal.head<2>() /
         normal.dot(ray);
}

bool MakePatchMap(const ReferencePatch& reference,
                  const PatchCamera& camera,
                  double depth,
                  PatchMap* map) {
  const RelativePose pose = MakeRelativePose(reference, camera);
  const Eigen::Vector3d offset = pose.translation / depth;
  const Eigen::Vector3d p = pose.rotation * reference.Ray() + offset;
  if (!(depth > 0.0) || !(p.z() > kMinDepth)) return false;
  const double x = p.x() / p.z();
  const double y = p.y() / p.z();
  const Eigen::Matrix2d lens = LensJacobian(camera, x, y, &map->center);
  if (!map->center.allFinite() || !(lens.determinant() > 0.0)) return false;
  Eigen::Matrix<double, 2, 3> perspective;
  perspective << 1.0, 0.0, -x, 0.0, 1.0, -y;
  const Eigen::Matrix<double, 2, 3> pixel_from_point =
      lens * perspective / p.z();
  map->affine =
      pixel_from_point * pose.rotation.leftCols<2>() * reference.ray_jacobian;
  map->epipole = pixel_from_point * offset;
  return map->affine.allFinite() && map->epipole.allFinite();
}

bool MakePatchWarp(const ReferencePatch& reference,
                   const PatchCamera& camera,
                   double depth,
                   const Eigen::Vector2d& slope,
                   PatchWarp* warp) {
  PatchMap map;
  if (!MakePatchMap(reference, camera, depth, &map)) return false;
  const Eigen::Matrix2d affine = map.Affine(slope);
  const RelativePose pose = MakeRelativePose(reference, camera);
  std::array<Eigen::Vector2d, 9> xy;
  for (int i = 0; i < 9; ++i) {
    const Eigen::Vector2d offset(kRayStep * (i % 3 - 1),
                                 kRayStep * (i / 3 - 1));
    if (!ProjectRay(pose,
                    camera,
                    reference.rays[i],
                    (1.0 + slope.dot(offset)) / depth,
                    &xy[i])) {
      return false;
    }
  }
  constexpr double kFactor = 1.0 / (kRayStep * kRayStep);
  const Eigen::Vector2d uu = 0.5 * kFactor * (xy[3] + xy[5] - 2.0 * xy[4]);
  const Eigen::Vector2d vv = 0.5 * kFactor * (xy[1] + xy[7] - 2.0 * xy[4]);
  const Eigen::Vector2d uv = 0.25 * kFactor * (xy[0] + xy[8] - xy[2] - xy[6]);
  for (int row = 0; row < 2; ++row) {
    warp->center[row] = map.center(row);
    warp->affine[2 * row] = static_cast<float>(affine(row, 0));
    warp->affine[2 * row + 1] = static_cast<float>(affine(row, 1));
    warp->quadratic[3 * row] = static_cast<float>(uu(row));
    warp->quadratic[3 * row + 1] = static_cast<float>(uv(row));
    warp->quadratic[3 * row + 2] = static_cast<float>(vv(row));
  }
  return true;
}

}  // namespace mfir
