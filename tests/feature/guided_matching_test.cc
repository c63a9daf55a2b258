#include "src/feature/guided_matching.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "src/geometry/epipolar_tolerance.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

using Matches = std::vector<std::pair<uint32_t, uint32_t>>;

constexpr double kFocalLength1 = 800.0;
constexpr double kFocalLength2 = 1200.0;

struct ViewOfPoints {
  Rigid3 cam_from_world;
  double focal_length;
  std::vector<Eigen::Vector3d> rays;
  std::vector<uint8_t> descriptors;

  ImageFeatures Features() const {
    return {cam_from_world, focal_length, &rays, descriptors.data()};
  }
};

// A random vector of length 512 without negative elements.
std::vector<double> RandomDescriptor(Random* random) {
  std::vector<double> values(128);
  double squared_norm = 0.0;
  for (double& value : values) {
    value = std::abs(random->Normal());
    squared_norm += value * value;
  }
  for (double& value : values) value *= 512.0 / std::sqrt(squared_norm);
  return values;
}

void AddFeature(const Eigen::Vector3d& ray,
                const std::vector<double>& descriptor,
                double noise,
                Random* random,
                ViewOfPoints* image) {
  image->rays.push_back(ray.normalized());
  for (const double value : descriptor) {
    image->descriptors.push_back(static_cast<uint8_t>(
        std::clamp(value + random->Normal(0.0, noise), 0.0, 255.0)));
  }
}

// Two cameras that look at points in a box in front of them. Descriptors come
// from a few classes only, so that many are ambiguous without geometry.
void MakeImages(const Rigid3& pose1,
                const Rigid3& pose2,
                uint64_t seed,
                ViewOfPoints* image1,
                ViewOfPoints* image2) {
  Random random({seed});
  *image1 = {pose1, kFocalLength1, {}, {}};
  *image2 = {pose2, kFocalLength2, {}, {}};
  std::vector<std::vector<double>> classes;
  for (int i = 0; i < 40; ++i) classes.push_back(RandomDescriptor(&random));
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d x =
        Eigen::Vector3d(0.0, 0.0, 4.0) + RandomVector(&random);
    const std::vector<double>& descriptor = classes[i % classes.size()];
    AddFeature(pose1 * x + RandomVector(&random, 0.004),
               descriptor,
               4.0,
               &random,
               image1);
    AddFeature(pose2 * x, descriptor, 4.0, &random, image2);
  }
}

// As COLMAP does it: every keypoint against every other.
Matches MatchBruteForce(const GuidedMatchingOptions& options,
                        const ViewOfPoints& image1,
                        const ViewOfPoints& image2) {
  const Eigen::Matrix3d E =
      EssentialMatrix(image1.cam_from_world, image2.cam_from_world);
  const size_t n1 = image1.rays.size();
  const size_t n2 = image2.rays.size();
  const Eigen::Vector3d baseline =
      image2.cam_from_world.Center() - image1.cam_from_world.Center();
  const auto side = [&](const ViewOfPoints& image, size_t idx) {
    return baseline.cross(image.cam_from_world.rotation.conjugate() *
                          image.rays[idx]);
  };
  Eigen::MatrixXd distances(n1, n2);
  for (size_t i = 0; i < n1; ++i) {
    for (size_t j = 0; j < n2; ++j) {
      const double error = EpipolarError(E,
                                         image1.rays[i],
                                         image2.rays[j],
                                         image1.focal_length,
                                         image2.focal_length);
      double product = 0.0;
      for (int k = 0; k < 128; ++k) {
        product += static_cast<double>(image1.descriptors[128 * i + k]) *
                   image2.descriptors[128 * j + k];
      }
      distances(i, j) = error <= options.max_error &&
                                side(image1, i).dot(side(image2, j)) > 0.0
                            ? std::acos(std::min(product / 262144.0, 1.0))
                            : M_PI_2;
    }
  }
  const auto best = [&](Eigen::VectorXd d) -> int {
    Eigen::Index idx;
    const double smallest = d.minCoeff(&idx);
    d(idx) = M_PI_2;
    return smallest <= options.max_distance &&
                   smallest < options.max_ratio * d.minCoeff()
               ? static_cast<int>(idx)
               : -1;
  };
  Matches matches;
  for (size_t i = 0; i < n1; ++i) {
    const int j = best(distances.row(i));
    if (j >= 0 && (!options.cross_check ||
                   best(distances.col(j)) == static_cast<int>(i))) {
      matches.emplace_back(i, j);
    }
  }
  return matches;
}

Rigid3 LookingAlongZ(const Eigen::Vector3d& center, double turn) {
  const Eigen::Quaterniond rotation(
      Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()));
  return {rotation, -(rotation * center)};
}

TEST(MatchGuided, FindsWhatAllPairsOfKeypointsGive) {
  const GuidedMatchingOptions options;
  for (uint64_t seed = 0; seed < 5; ++seed) {
    Random random({100 + seed});
    ViewOfPoints image1, image2;
    MakeImages(LookingAlongZ(RandomVector(&random, 0.3), 0.1),
               LookingAlongZ(RandomVector(&random, 0.3), -0.1),
               seed,
               &image1,
               &image2);
    const Matches expected = MatchBruteForce(options, image1, image2);
    EXPECT_GT(expected.size(), 50);
    EXPECT_EQ(MatchGuided(options, image1.Features(), image2.Features()),
              expected);
    GuidedMatchingOptions one_way = options;
    one_way.cross_check = false;
    one_way.max_error = 30.0;
    EXPECT_EQ(MatchGuided(one_way, image1.Features(), image2.Features()),
              MatchBruteForce(one_way, image1, image2));
  }
}

// One camera in front of the other: the epipoles are inside of both images, and
// longitudes wrap around.
TEST(MatchGuided, WorksAroundTheEpipoles) {
  const GuidedMatchingOptions options;
  ViewOfPoints image1, image2;
  MakeImages(LookingAlongZ({0.01, 0.02, 0.0}, 0.0),
             LookingAlongZ({0.0, 0.0, 1.0}, 0.0),
             7,
             &image1,
             &image2);
  const Matches expected = MatchBruteForce(options, image1, image2);
  EXPECT_GT(expected.size(), 50);
  Matches found = MatchGuided(options, image1.Features(), image2.Features());
  EXPECT_EQ(found, expected);
}

// Descriptors 0.1 rad apart, geometry decides: of two candidates with the same
// descriptor, the one on the line.
TEST(MatchGuided, OnlyKeypointsNearTheLineAreCandidates) {
  Random random({3});
  ViewOfPoints image1{LookingAlongZ({0.0, 0.0, 0.0}, 0.0), 1000.0, {}, {}};
  ViewOfPoints image2{LookingAlongZ({1.0, 0.0, 0.0}, 0.0), 1000.0, {}, {}};
  const std::vector<double> descriptor = RandomDescriptor(&random);
  AddFeature({0.1, 0.0, 1.0}, descriptor, 0.0, &random, &image1);
  // Pure x baseline: lines are rows. 2 and 40 pixels off the row.
  AddFeature({-0.2, 0.040, 1.0}, descriptor, 0.0, &random, &image2);
  AddFeature({-0.1, 0.002, 1.0}, descriptor, 0.0, &random, &image2);
  GuidedMatchingOptions options;
  options.max_error = 5.0;
  EXPECT_EQ(MatchGuided(options, image1.Features(), image2.Features()),
            (Matches{{0, 1}}));
  // Both are candidates: ambiguous.
  options.max_error = 50.0;
  EXPECT_TRUE(
      MatchGuided(options, image1.Features(), image2.Features()).empty());
  // None is. Sampson's distance shares the 2 pixels out between the images.
  options.max_error = 1.3;
  EXPECT_TRUE(
      MatchGuided(options, image1.Features(), image2.Features()).empty());
}

TEST(MatchGuided, KeypointsWithoutRayMatchNothing) {
  ViewOfPoints image1, image2;
  MakeImages(LookingAlongZ({0.0, 0.0, 0.0}, 0.1),
             LookingAlongZ({0.5, 0.0, 0.0}, -0.1),
             1,
             &image1,
             &image2);
  const Matches before = MatchGuided({}, image1.Features(), image2.Features());
  const uint32_t lost1 = before[0].first;
  const uint32_t lost2 = before[1].second;
  image1.rays[lost1].setConstant(std::numeric_limits<double>::quiet_NaN());
  image2.rays[lost2].setConstant(std::numeric_limits<double>::quiet_NaN());
  const Matches after = MatchGuided({}, image1.Features(), image2.Features());
  EXPECT_GE(after.size() + 2, before.size());
  for (const auto& match : after) {
    EXPECT_NE(match.first, lost1);
    EXPECT_NE(match.second, lost2);
  }
}

}  // namespace
}  // namespace mfir
