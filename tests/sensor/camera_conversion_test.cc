#include "src/sensor/camera_conversion.h"

#include <limits>

#include <gtest/gtest.h>

#include "src/util/errors.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

std::vector<double> Convert(const std::string& source,
                            const std::vector<double>& params,
                            const std::string& target) {
  return ConvertCameraParams(*FindCameraModel(source),
                             params,
                             kTestWidth,
                             kTestHeight,
                             *FindCameraModel(target));
}

// RMS distance (px) of the projections of a grid of image points.
double RmsDifference(const std::string& source,
                     const std::vector<double>& source_params,
                     const std::string& target,
                     const std::vector<double>& target_params) {
  constexpr int kNum = 20;
  double sum = 0.0;
  for (int i = 0; i < kNum; ++i) {
    for (int j = 0; j < kNum; ++j) {
      Eigen::Vector2d uv;
      Eigen::Vector2d source_xy;
      Eigen::Vector2d target_xy;
      FindCameraModel(source)->Unproject(source_params.data(),
                                         (i + 0.5) * kTestWidth / kNum,
                                         (j + 0.5) * kTestHeight / kNum,
                                         uv.data());
      FindCameraModel(source)->Project(
          source_params.data(), uv.x(), uv.y(), source_xy.data());
      FindCameraModel(target)->Project(
          target_params.data(), uv.x(), uv.y(), target_xy.data());
      sum += (target_xy - source_xy).squaredNorm();
    }
  }
  return std::sqrt(sum / (kNum * kNum));
}

void ExpectParams(const std::vector<double>& actual,
                  const std::vector<double>& expected,
                  double tolerance) {
  ASSERT_EQ(actual.size(), expected.size());
  for (size_t i = 0; i < actual.size(); ++i) {
    EXPECT_NEAR(actual[i],
                expected[i],
                tolerance * std::max(1.0, std::abs(expected[i])))
        << "parameter " << i;
  }
}

TEST(CameraConversion, IsExactWhereTheTargetContainsTheSource) {
  ExpectParams(Convert("SIMPLE_PINHOLE", {1000, 407, 295}, "PINHOLE"),
               {1000, 1000, 407, 295},
               1e-9);
  ExpectParams(Convert("SIMPLE_RADIAL", {1000, 407, 295, -0.1}, "RADIAL"),
               {1000, 407, 295, -0.1, 0},
               1e-6);
  ExpectParams(Convert("RADIAL", {1000, 407, 295, -0.1, 0.05}, "OPENCV"),
               {1000, 1000, 407, 295, -0.1, 0.05, 0, 0},
               1e-6);
  ExpectParams(
      Convert(
          "RADIAL_FISHEYE", {1000, 407, 295, 0.05, -0.02}, "OPENCV_FISHEYE"),
      {1000, 1000, 407, 295, 0.05, -0.02, 0, 0},
      1e-4);
}

// The rational distortion of FULL_OPENCV is not unique, its projections are.
TEST(CameraConversion, OpencvToFullOpencvKeepsProjections) {
  const std::vector<double> source = {
      1000, 1004, 407, 295, -0.1, 0.05, 0.002, -0.001};
  const std::vector<double> target = Convert("OPENCV", source, "FULL_OPENCV");
  EXPECT_LT(RmsDifference("OPENCV", source, "FULL_OPENCV", target), 1e-6);
  ExpectParams(
      {target.begin(), target.begin() + 4}, {1000, 1004, 407, 295}, 1e-6);
}

TEST(CameraConversion, StrongDistortionStaysExact) {
  const std::vector<double> source = {700, 380, 310, -0.25, 0.08};
  EXPECT_LT(
      RmsDifference(
          "RADIAL", source, "OPENCV", Convert("RADIAL", source, "OPENCV")),
      1e-6);
  const std::vector<double> fisheye = {350, 380, 310, 0.1, -0.02};
  EXPECT_LT(RmsDifference("RADIAL_FISHEYE",
                          fisheye,
                          "OPENCV_FISHEYE",
                          Convert("RADIAL_FISHEYE", fisheye, "OPENCV_FISHEYE")),
            1e-6);
}

class SameModelTest : public testing::TestWithParam<const CameraModel*> {};

INSTANTIATE_TEST_SUITE_P(All,
                         SameModelTest,
                         testing::ValuesIn(AllCameraModels()),
                         [](const auto& info) { return info.param->Name(); });

TEST_P(SameModelTest, ConversionToTheSameModelKeepsProjections) {
  const std::string& name = GetParam()->Name();
  const std::vector<double> params = TypicalParams(*GetParam());
  EXPECT_LT(RmsDifference(name, params, name, Convert(name, params, name)),
            1e-5);
}

TEST_P(SameModelTest, PinholeIsContained) {
  const std::string& name = GetParam()->Name();
  const std::vector<double> pinhole = {1000, 407, 295};
  const std::vector<double> params = Convert("SIMPLE_PINHOLE", pinhole, name);
  // Fisheye models are not exactly a pinhole: 0.4 rad by four coefficients.
  double tolerance = 1e-5;
  if (name == "SIMPLE_RADIAL_FISHEYE") tolerance = 1.0;
  if (name == "RADIAL_FISHEYE") tolerance = 0.1;
  if (name == "OPENCV_FISHEYE" || name == "THIN_PRISM_FISHEYE") {
    tolerance = 0.01;
  }
  // No coefficients at all, in COLMAP 4.
  if (name == "SIMPLE_FISHEYE" || name == "FISHEYE") tolerance = 5.0;
  EXPECT_LT(RmsDifference("SIMPLE_PINHOLE", pinhole, name, params), tolerance);
}

// Where the target is simpler: no change of any parameter comes closer.
TEST(CameraConversion, IsTheLeastSquaresFitOtherwise) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"OPENCV", "SIMPLE_RADIAL"},
      {"OPENCV", "PINHOLE"},
      {"OPENCV_FISHEYE", "OPENCV"},
      {"FULL_OPENCV", "RADIAL"},
      {"FOV", "SIMPLE_RADIAL"},
      {"THIN_PRISM_FISHEYE", "SIMPLE_PINHOLE"}};
  for (const auto& [source, target] : cases) {
    SCOPED_TRACE(source + " to " + target);
    const std::vector<double> source_params =
        TypicalParams(*FindCameraModel(source));
    const std::vector<double> params = Convert(source, source_params, target);
    const double rms = RmsDifference(source, source_params, target, params);
    EXPECT_TRUE(std::isfinite(rms));
    for (size_t i = 0; i < params.size(); ++i) {
      for (const double sign : {-1.0, 1.0}) {
        std::vector<double> changed = params;
        changed[i] += sign * 1e-4 * std::max(0.1, std::abs(params[i]));
        EXPECT_GE(RmsDifference(source, source_params, target, changed),
                  rms * (1.0 - 1e-9))
            << "parameter " << i;
      }
    }
  }
}

TEST(CameraConversion, OpencvToSimpleRadialDropsTangentialDistortion) {
  const std::vector<double> source = {1000, 1000, 407, 295, -0.1, 0, 0, 0};
  ExpectParams(
      Convert("OPENCV", source, "SIMPLE_RADIAL"), {1000, 407, 295, -0.1}, 1e-6);
}

class FovTest : public testing::TestWithParam<double> {};

INSTANTIATE_TEST_SUITE_P(Omegas,
                         FovTest,
                         testing::Values(0.02, 0.1, 0.3, 0.6, 0.9, 1.2));

TEST_P(FovTest, ConvertsToPolynomialsAndBack) {
  const std::vector<double> fov = {1000, 1004, 407, 295, GetParam()};
  const std::vector<double> opencv = Convert("FOV", fov, "OPENCV");
  EXPECT_LT(RmsDifference("FOV", fov, "OPENCV", opencv), 0.05);
  const std::vector<double> back = Convert("OPENCV", opencv, "FOV");
  EXPECT_LT(RmsDifference("OPENCV", opencv, "FOV", back), 0.05);
  EXPECT_LT(RmsDifference("FOV", fov, "FOV", back), 0.1);
}

TEST_P(FovTest, ConvertsToItself) {
  const std::vector<double> fov = {1000, 1004, 407, 295, GetParam()};
  EXPECT_LT(RmsDifference("FOV", fov, "FOV", Convert("FOV", fov, "FOV")), 1e-4);
}

TEST(CameraConversion, RefusesWhatCannotBeInverted) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(Convert("SIMPLE_RADIAL", {1000, 407, 295, nan}, "RADIAL"),
               InputError);
  EXPECT_THROW(Convert("SIMPLE_PINHOLE", {0, 407, 295}, "PINHOLE"), InputError);
}

}  // namespace
}  // namespace mfir
