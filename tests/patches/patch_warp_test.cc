#include "src/patches/patch_warp.h"

#include <cmath>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"
#include "src/patches/patch_slope.h"
#include "src/util/random.h"
#include "tests/support/patch_images.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

PatchCamera MakeCamera(const CameraModel& model,
                       const Eigen::Vector3d& center) {
  return {&model, LookAtOrigin(center), TypicalParams(model)};
}

// Where the surface point at an offset from the keypoint is seen.
Eigen::Vector2d ExactPosition(const PatchCamera& reference,
                              const PatchCamera& other,
                              const Eigen::Vector2d& keypoint,
                              double depth,
                              const Eigen::Vector2d& slope,
                              const Eigen::Vector2d& offset) {
  double uv[2];
  reference.model->Unproject(reference.params.data(),
                             keypoint.x() + offset.x(),
                             keypoint.y() + offset.y(),
                             uv);
  const double point_depth = depth / (1.0 + slope.dot(offset));
  const Eigen::Vector3d p = point_depth * Eigen::Vector3d(uv[0], uv[1], 1.0);
  const Eigen::Vector3d world = reference.cam_from_world.rotation.conjugate() *
                                (p - reference.cam_from_world.translation);
  return ProjectInto(other, world);
}

TEST(PatchWarp, HandComputedForPinholes) {
  const CameraModel* model = FindCameraModel("SIMPLE_PINHOLE");
  const PatchCamera reference = {model, Rigid3(), {100.0, 50.0, 40.0}};
  PatchCamera other = reference;
  other.cam_from_world.translation = Eigen::Vector3d(-1.0, 0.0, 0.0);
  ReferencePatch patch;
  ASSERT_TRUE(MakeReferencePatch(reference, {70.0, 60.0}, &patch));
  EXPECT_NEAR(patch.Ray().x(), 0.2, 1e-12);
  EXPECT_NEAR(patch.Ray().y(), 0.2, 1e-12);
  PatchMap map;
  ASSERT_TRUE(MakePatchMap(patch, other, 10.0, &map));
  // Disparity: 100 * 1 / 10.
  EXPECT_NEAR(map.center.x(), 60.0, 1e-9);
  EXPECT_NEAR(map.center.y(), 60.0, 1e-9);
  EXPECT_NEAR((map.affine - Eigen::Matrix2d::Identity()).norm(), 0.0, 1e-9);
  EXPECT_NEAR(map.epipole.x(), -10.0, 1e-9);
  EXPECT_NEAR(map.epipole.y(), 0.0, 1e-9);
  // The inverse depth grows by 2 % per pixel of y, and the disparity with it.
  EXPECT_NEAR(map.Affine({0.0, 0.02})(0, 1), -0.2, 1e-9);
  // Straight on is the plane with the ray as its normal: (0.2, 0.2, 1).
  const Eigen::Vector2d facing = patch.FacingSlope();
  EXPECT_NEAR(facing.x(), 0.2 / 1.08 / 100.0, 1e-9);
  EXPECT_NEAR(facing.y(), 0.2 / 1.08 / 100.0, 1e-9);
}

TEST(PatchWarp, ViewIntoTheSameCameraIsTheIdentity) {
  for (const CameraModel* model : AllCameraModels()) {
    const PatchCamera camera = MakeCamera(*model, {0.3, 0.2, -3.0});
    ReferencePatch patch;
    ASSERT_TRUE(MakeReferencePatch(camera, {500.0, 200.0}, &patch));
    PatchWarp warp;
    ASSERT_TRUE(MakePatchWarp(patch, camera, 2.0, {0.001, -0.002}, &warp));
    EXPECT_NEAR(warp.center[0], 500.0, 1e-4) << model->Name();
    EXPECT_NEAR(warp.center[1], 200.0, 1e-4) << model->Name();
    for (int i = 0; i < 4; ++i) {
      EXPECT_NEAR(warp.affine[i], i % 3 == 0 ? 1.0 : 0.0, 1e-5);
    }
    for (const float q : warp.quadratic) EXPECT_NEAR(q, 0.0, 1e-6);
  }
}

TEST(PatchWarp, JacobiansByFiniteDifferencesForEveryCameraModel) {
  constexpr double kStep = 1e-3;
  const Eigen::Vector2d keypoint(620.0, 130.0);
  const Eigen::Vector2d slope(0.0012, -0.0008);
  const double depth = 2.9;
  for (const CameraModel* model : AllCameraModels()) {
    SCOPED_TRACE(model->Name());
    const PatchCamera reference = MakeCamera(*model, {0.3, 0.2, -3.0});
    const PatchCamera other = MakeCamera(*model, {1.5, -0.4, -2.6});
    const auto exact = [&](const Eigen::Vector2d& offset, double factor) {
      return ExactPosition(
          reference, other, keypoint, depth * factor, slope, offset);
    };
    ReferencePatch patch;
    PatchMap map;
    PatchWarp warp;
    ASSERT_TRUE(MakeReferencePatch(reference, keypoint, &patch));
    ASSERT_TRUE(MakePatchMap(patch, other, depth, &map));
    ASSERT_TRUE(MakePatchWarp(patch, other, depth, slope, &warp));
    EXPECT_LT((map.center - exact({0.0, 0.0}, 1.0)).norm(), 1e-3);
    const Eigen::Matrix2d affine = map.Affine(slope);
    for (int i = 0; i < 2; ++i) {
      const Eigen::Vector2d step = 0.5 * Eigen::Vector2d::Unit(i);
      const Eigen::Vector2d numeric = exact(step, 1.0) - exact(-step, 1.0);
      EXPECT_LT((affine.col(i) - numeric).norm(), 1e-3) << i;
      EXPECT_FLOAT_EQ(warp.affine[i], static_cast<float>(affine(0, i)));
      EXPECT_FLOAT_EQ(warp.affine[2 + i], static_cast<float>(affine(1, i)));
    }
    const Eigen::Vector2d by_log_inverse_depth =
        (exact({0.0, 0.0}, 1.0 / (1.0 + kStep)) -
         exact({0.0, 0.0}, 1.0 / (1.0 - kStep))) /
        (2.0 * kStep);
    EXPECT_LT((map.epipole - by_log_inverse_depth).norm(),
              1e-3 * map.epipole.norm());
    // The whole warp, at the rim of the disc.
    for (const Eigen::Vector2d& u : {Eigen::Vector2d(5.0, 0.0),
                                     Eigen::Vector2d(-3.0, 4.0),
                                     Eigen::Vector2d(0.0, -5.0)}) {
      const float* q = warp.quadratic;
      const Eigen::Vector2d position =
          map.center + affine * u +
          Eigen::Vector2d(q[0] * u.x() * u.x() + q[1] * u.x() * u.y() +
                              q[2] * u.y() * u.y(),
                          q[3] * u.x() * u.x() + q[4] * u.x() * u.y() +
                              q[5] * u.y() * u.y());
      EXPECT_LT((position - exact(u, 1.0)).norm(), 5e-3);
    }
  }
}

TEST(PatchWarp, RefusesPointsBehindACamera) {
  const CameraModel* model = FindCameraModel("PINHOLE");
  const PatchCamera reference = MakeCamera(*model, {0.0, 0.0, -3.0});
  const PatchCamera opposite = MakeCamera(*model, {0.0, 0.0, 3.0});
  ReferencePatch patch;
  PatchMap map;
  PatchWarp warp;
  ASSERT_TRUE(MakeReferencePatch(reference, {400.0, 300.0}, &patch));
  EXPECT_TRUE(MakePatchMap(patch, opposite, 2.0, &map));
  EXPECT_FALSE(MakePatchMap(patch, opposite, 7.0, &map));
  EXPECT_FALSE(MakePatchWarp(patch, opposite, 7.0, {0.0, 0.0}, &warp));
  EXPECT_FALSE(MakePatchMap(patch, opposite, -1.0, &map));
}

TEST(EstimateSlopes, FindsTheTiltOfAPlaneAlsoFromWrongKeypoints) {
  const CameraModel* model = FindCameraModel("OPENCV");
  std::vector<PatchCamera> cameras;
  for (const double azimuth : {0.0, -0.35, 0.3, 0.15}) {
    cameras.push_back(
        MakeCamera(*model,
                   3.0 * Eigen::Vector3d(std::sin(azimuth),
                                         0.4 * std::sin(3.0 * azimuth + 0.5),
                                         -std::cos(azimuth))));
  }
  for (const double tilt : {0.0, 0.5, -0.9}) {
    TexturedPlane plane{
        Eigen::Vector3d(std::sin(tilt), 0.3, std::cos(tilt)).normalized(),
        0.05,
        Eigen::Vector3d::UnitX(),
        WaveTexture(0.02, 9)};
    plane.x_axis = Eigen::Vector3d::UnitY().cross(plane.normal).normalized();
    Random random({4});
    std::vector<SplineImage> images;
    for (const PatchCamera& camera : cameras) {
      images.push_back(RenderPlane(plane, camera, kTestWidth, kTestHeight, [&] {
        return random.Normal(0.0, 1.0);
      }));
    }
    const Eigen::Vector2d keypoint(412.3, 288.7);
    const Eigen::Vector3d point = plane.Intersect(cameras[0], keypoint);
    const double depth = (cameras[0].cam_from_world * point).z();
    ReferencePatch reference;
    std::vector<PatchTemplate> patches(1);
    ASSERT_TRUE(MakeReferencePatch(cameras[0], keypoint, &reference));
    ASSERT_TRUE(MakePatchTemplate(images[0], keypoint, &patches[0]));
    std::vector<SlopeProblem> problems(1);
    problems[0].reference = &reference;
    problems[0].patch = &patches[0];
    std::vector<SlopeView>& views = problems[0].views;
    views.resize(3);
    for (size_t i = 0; i < 3; ++i) {
      views[i].image_idx = i + 1;
      ASSERT_TRUE(
          MakePatchMap(reference, cameras[i + 1], depth, &views[i].map));
      views[i].xy = ProjectInto(cameras[i + 1], point) +
                    Eigen::Vector2d(0.4, i == 1 ? -0.4 : 0.3);
    }
    const Eigen::Vector3d normal =
        cameras[0].cam_from_world.rotation * plane.normal;
    const Eigen::Vector2d expected = reference.ray_jacobian.transpose() *
                                     normal.head<2>() /
                                     normal.dot(reference.Ray());
    CpuPatchBackend backend;
    backend.SetImages(images);
    backend.SetTemplates(patches);
    EstimateSlopes(1, &backend, &problems);
    // In tangents of the tilt.
    EXPECT_LT((problems[0].slope - expected).norm() * 1000.0, 0.06) << tilt;
  }
}

}  // namespace
}  // namespace mfir
