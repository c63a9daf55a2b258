#include "src/estimators/ray_intersection.h"

#include <cmath>

#include <gtest/gtest.h>

namespace mfir {
namespace {

Ray RayThrough(const Eigen::Vector3d& center, const Eigen::Vector3d& xyz) {
  return {center, (xyz - center).normalized()};
}

std::vector<Ray> RaysThrough(const Eigen::Vector3d& xyz, size_t num_rays) {
  std::vector<Ray> rays;
  for (size_t i = 0; i < num_rays; ++i) {
    const double angle = 0.5 * static_cast<double>(i);
    rays.push_back(RayThrough(
        Eigen::Vector3d(3.0 * std::cos(angle), 3.0 * std::sin(angle), 1.0),
        xyz));
  }
  return rays;
}

TEST(RayIntersections, RaysThatMeetGiveTheirPoint) {
  const Eigen::Vector3d xyz(0.1, -0.2, 0.3);
  for (const size_t num_rays : {2, 3, 6, 7, 12}) {
    const auto intersections = RayIntersections(RaysThrough(xyz, num_rays));
    // All rays at once, then pairs: all of them, or two per ray.
    EXPECT_EQ(
        intersections.size(),
        1 + (num_rays > 6 ? 2 * num_rays : num_rays * (num_rays - 1) / 2));
    for (const Eigen::Vector3d& intersection : intersections) {
      EXPECT_LT((intersection - xyz).norm(), 1e-12);
    }
  }
}

// Rays along x and along y, 2 apart: the middle between them.
TEST(RayIntersections, SkewRaysGiveTheMiddle) {
  const auto intersections =
      RayIntersections({{{-5, 0, 1}, {1, 0, 0}}, {{0, -7, -1}, {0, 1, 0}}});
  ASSERT_EQ(intersections.size(), 2);
  EXPECT_LT(intersections[1].norm(), 1e-12);
}

TEST(RayIntersections, EveryChoiceOfOutliersIsThere) {
  const Eigen::Vector3d a(0.1, -0.2, 0.3);
  const Eigen::Vector3d b(0.4, 0.2, -0.1);
  std::vector<Ray> rays = RaysThrough(a, 4);
  rays[0] = RayThrough(rays[0].center, b);
  rays[2] = RayThrough(rays[2].center, b);
  const auto intersections = RayIntersections(rays);
  for (const Eigen::Vector3d& xyz : {a, b}) {
    bool found = false;
    for (const Eigen::Vector3d& intersection : intersections) {
      found = found || (intersection - xyz).norm() < 1e-12;
    }
    EXPECT_TRUE(found) << xyz.transpose();
  }
}

TEST(RayIntersections, OneOutlierAmongManyHardlyMoves) {
  const Eigen::Vector3d xyz(0.1, -0.2, 0.3);
  std::vector<Ray> rays = RaysThrough(xyz, 10);
  rays[3] = RayThrough(rays[3].center, xyz + Eigen::Vector3d(0, 0, 1));
  EXPECT_LT((RayIntersections(rays)[0] - xyz).norm(), 1e-3);
}

TEST(RayIntersections, NothingToIntersect) {
  EXPECT_TRUE(RayIntersections({}).empty());
  EXPECT_TRUE(RayIntersections({{{0, 0, 0}, {1, 0, 0}}}).empty());
  // Parallel rays: no pair; all at once at most a finite point.
  for (const Eigen::Vector3d& xyz :
       RayIntersections({{{0, 0, 0}, {1, 0, 0}}, {{0, 1, 0}, {1, 0, 0}}})) {
    EXPECT_TRUE(xyz.allFinite());
  }
}

}  // namespace
}  // namespace mfir
