// What intrinsics do in the image, against values by hand.

#include "src/report/camera_maps.h"

#include <cmath>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"

namespace mfir {
namespace {

CameraValues Pinhole(double fx, double fy, double cx, double cy) {
  return {FindCameraModel("PINHOLE"), {fx, fy, cx, cy}, {}};
}

TEST(CameraMapsTest, GridPointsAreTheCentresOfCells) {
  const std::vector<Eigen::Vector2d> points = GridPoints(400, 200, 4, 2);
  ASSERT_EQ(points.size(), 8);
  EXPECT_EQ(points[0], Eigen::Vector2d(50, 50));
  EXPECT_EQ(points[3], Eigen::Vector2d(350, 50));
  EXPECT_EQ(points[7], Eigen::Vector2d(350, 150));
}

TEST(CameraMapsTest, DisplacementOfShiftAndScale) {
  // 1 % longer along x, 2 % along y, shifted by (3, -1): at (500, 300) the ray
  // is (100 / 1000, 100 / 1000).
  const std::vector<Eigen::Vector2d> displacements =
      Displacements(Pinhole(1000, 1000, 400, 200),
                    Pinhole(1010, 1020, 403, 199),
                    {{500, 300}});
  EXPECT_NEAR(displacements[0].x(), 3 + 0.1 * 10, 1e-9);
  EXPECT_NEAR(displacements[0].y(), -1 + 0.1 * 20, 1e-9);
}

TEST(CameraMapsTest, DisplacementBetweenModels) {
  // k = 0.1 at u = 0.2 moves the pixel by f k u^3.
  const CameraValues radial = {
      FindCameraModel("SIMPLE_RADIAL"), {1000, 400, 200, 0.1}, {}};
  const std::vector<Eigen::Vector2d> displacements =
      Displacements(Pinhole(1000, 1000, 400, 200), radial, {{600, 200}});
  EXPECT_NEAR(displacements[0].x(), 1000 * 0.1 * 0.008, 1e-9);
  EXPECT_NEAR(displacements[0].y(), 0, 1e-9);
}

TEST(CameraMapsTest, RaysThatAreNoneHaveNoDisplacement) {
  // r (1 - r^2) has its maximum 0.385 at 0.577: no ray is seen farther out.
  const CameraValues folded = {
      FindCameraModel("SIMPLE_RADIAL"), {1000, 0, 0, -1.0}, {}};
  const std::vector<Eigen::Vector2d> displacements =
      Displacements(folded, Pinhole(1000, 1000, 0, 0), {{300, 0}, {900, 0}});
  EXPECT_TRUE(displacements[0].allFinite());
  EXPECT_FALSE(displacements[1].allFinite());
}

TEST(CameraMapsTest, ProjectionStdsByHand) {
  ReportCamera camera;
  camera.model = FindCameraModel("PINHOLE");
  camera.params = {1000, 1000, 400, 200};
  camera.covariance = Eigen::MatrixXd::Zero(4, 4);
  camera.covariance(0, 0) = 4.0;  // fx to 2 px
  camera.covariance(2, 2) = 0.25;
  // x: (0.3 * 2)^2 + 0.5^2; nothing along y.
  EXPECT_NEAR(
      ProjectionStds(camera, {{700, 200}})[0], std::sqrt(0.36 + 0.25), 1e-12);
  // Errors that cancel out.
  camera.covariance(0, 2) = camera.covariance(2, 0) = -1.0;
  EXPECT_NEAR(ProjectionStds(camera, {{650, 200}})[0],
              std::sqrt(0.25 + 0.25 - 0.5),
              1e-7);
  camera.covariance(1, 1) = NAN;
  EXPECT_TRUE(std::isnan(ProjectionStds(camera, {{700, 300}})[0]));
}

TEST(CameraMapsTest, DistortionCurveOfAPolynomial) {
  const CameraValues radial = {
      FindCameraModel("SIMPLE_RADIAL"), {1000, 300, 400, 0.1}, {}};
  const std::vector<Eigen::Vector2d> curve = DistortionCurve(radial, 600, 800);
  ASSERT_EQ(curve.size(), 25);
  EXPECT_EQ(curve.front(), Eigen::Vector2d::Zero());
  // The corner.
  EXPECT_NEAR(curve.back().x(), 500, 1e-9);
  for (const Eigen::Vector2d& point : curve) {
    // With the undistorted radius u: r = u + 0.1 u^3 (in units of f).
    const double u = (point.x() - point.y()) / 1000;
    EXPECT_NEAR(point.y(), 1000 * 0.1 * u * u * u, 1e-4);
  }
}

TEST(CameraMapsTest, PinholeValuesAndStds) {
  CameraValues camera = Pinhole(1000, 1010, 400, 200);
  camera.params_std = {3, 4, 1, NAN};
  EXPECT_EQ(ToPinhole(camera).focal_length, 1005);
  EXPECT_EQ(ToPinhole(camera).principal_point, Eigen::Vector2d(400, 200));
  EXPECT_NEAR(ToPinholeStds(camera).focal_length, std::sqrt(12.5), 1e-12);
  EXPECT_TRUE(std::isnan(ToPinholeStds(camera).principal_point));
  camera.params_std.clear();
  EXPECT_TRUE(std::isnan(ToPinholeStds(camera).focal_length));
}

}  // namespace
}  // namespace mfir
