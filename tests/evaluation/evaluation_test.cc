#include "src/evaluation/evaluation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

CameraIntrinsics MakeCamera(const std::string& name,
                            const std::vector<double>& params,
                            const std::string& model = "PINHOLE") {
  return {name, FindCameraModel(model), 1000, 500, params};
}

// Functions, since COLMAP's models are not ready before main.
std::vector<CameraIntrinsics> Truth() {
  return {MakeCamera("1", {1000, 1000, 500, 250}),
          MakeCamera("2", {500, 500, 400, 200})};
}

// Errors: +10 -10 +3 -4 and +5 0 0 +2 px; +10 -10 +10 0 permille.
FrameIntrinsics GoodEstimate() {
  return {"a",
          {MakeCamera("1", {1010, 990, 503, 246}),
           MakeCamera("2", {505, 500, 400, 202})}};
}

// Errors: +2 +1 0 0.
FrameIntrinsics BetterEstimate() {
  return {"b", {MakeCamera("1", {1002, 1001, 500, 250})}};
}

void ExpectStatistic(const FrameStatistic& statistic,
                     double mean,
                     double max,
                     double min) {
  EXPECT_NEAR(statistic.mean, mean, 1e-9);
  ASSERT_TRUE(statistic.max && statistic.min);
  EXPECT_NEAR(*statistic.max, max, 1e-9);
  EXPECT_NEAR(*statistic.min, min, 1e-9);
}

void ExpectSpread(const ErrorSpread& spread,
                  double median,
                  double p95,
                  double max) {
  EXPECT_NEAR(spread.median, median, 1e-9);
  EXPECT_NEAR(spread.p95, p95, 1e-9);
  EXPECT_NEAR(spread.max, max, 1e-9);
}

// The message of the InputError that evaluating ends in, "" without one.
std::string ErrorMessage(const std::vector<FrameIntrinsics>& estimates,
                         const std::vector<CameraIntrinsics>& truth) {
  try {
    EvaluateIntrinsics(estimates, truth);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

bool Contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

TEST(EvaluateIntrinsics, PaperMetricsOfOneEstimate) {
  const Evaluation evaluation = EvaluateIntrinsics({GoodEstimate()}, Truth());
  EXPECT_NEAR(evaluation.focal_abs.mean, (20 + 5) / 2.0, 1e-9);
  EXPECT_NEAR(evaluation.focal_rel.mean, (20 + 10) / 2.0, 1e-9);
  EXPECT_NEAR(evaluation.pp_abs.mean, (7 + 2) / 2.0, 1e-9);
  EXPECT_NEAR(evaluation.pp_rel.mean, ((3 + 8) + 4) / 2.0, 1e-9);
  for (const FrameStatistic& statistic : {evaluation.focal_abs,
                                          evaluation.focal_rel,
                                          evaluation.pp_abs,
                                          evaluation.pp_rel}) {
    EXPECT_FALSE(statistic.max);
    EXPECT_FALSE(statistic.min);
  }
  EXPECT_EQ(evaluation.num_cameras, 2);
  EXPECT_EQ(evaluation.frames.size(), 1);
  EXPECT_TRUE(evaluation.missing_cameras.empty());
  EXPECT_TRUE(evaluation.extra_cameras.empty());
}

TEST(EvaluateIntrinsics, CommonPartAndRest) {
  const Evaluation evaluation = EvaluateIntrinsics({GoodEstimate()}, Truth());
  EXPECT_NEAR(evaluation.focal_scale.mean, (10 - 10 + 10 + 0) / 4.0, 1e-9);
  EXPECT_NEAR(evaluation.pp_shift_x.mean, 1.5, 1e-9);
  EXPECT_NEAR(evaluation.pp_shift_y.mean, -1.0, 1e-9);
  // Focal: 7.5 -12.5 and 7.5 -2.5 permille. Principal point: 1.5 -3, -1.5 3.
  EXPECT_NEAR(evaluation.rest_focal_rel.mean, (20 + 10) / 2.0, 1e-9);
  EXPECT_NEAR(evaluation.rest_pp_abs.mean, 4.5, 1e-9);
}

TEST(EvaluateIntrinsics, SpreadPerAxis) {
  const Evaluation evaluation = EvaluateIntrinsics({GoodEstimate()}, Truth());
  ExpectSpread(evaluation.spread_px[0], 7.5, 9.75, 10);
  ExpectSpread(evaluation.spread_px[1], 5, 9.5, 10);
  ExpectSpread(evaluation.spread_px[2], 1.5, 2.85, 3);
  ExpectSpread(evaluation.spread_px[3], 3, 3.9, 4);
  ExpectSpread(evaluation.spread_permille[0], 10, 10, 10);
  ExpectSpread(evaluation.spread_permille[1], 5, 9.5, 10);
}

TEST(EvaluateIntrinsics, MeanMaxMinOverFrames) {
  const Evaluation evaluation =
      EvaluateIntrinsics({GoodEstimate(), BetterEstimate()}, Truth());
  ExpectStatistic(evaluation.focal_abs, 7.75, 12.5, 3);
  ExpectStatistic(evaluation.focal_rel, 9, 15, 3);
  ExpectStatistic(evaluation.pp_abs, 2.25, 4.5, 0);
  ExpectStatistic(evaluation.pp_rel, 3.75, 7.5, 0);
  ExpectStatistic(evaluation.focal_scale, 2, 2.5, 1.5);
  ExpectStatistic(evaluation.pp_shift_x, 0.75, 1.5, 0);
  ExpectStatistic(evaluation.pp_shift_y, -0.5, 0, -1);
  ExpectStatistic(evaluation.rest_focal_rel, 8, 15, 1);
  ExpectStatistic(evaluation.rest_pp_abs, 2.25, 4.5, 0);
  // fx over cameras and frames: 2, 5, 10.
  ExpectSpread(evaluation.spread_px[0], 5, 9.5, 10);
  EXPECT_EQ(evaluation.num_cameras, 2);
  EXPECT_EQ(evaluation.frames.size(), 2);
}

TEST(EvaluateIntrinsics, OneFocalLengthCountsForBothAxes) {
  const Evaluation evaluation = EvaluateIntrinsics(
      {{"", {MakeCamera("1", {1010, 500, 250}, "SIMPLE_PINHOLE")}}},
      {MakeCamera("1", {1000, 1005, 500, 250})});
  EXPECT_NEAR(evaluation.focal_abs.mean, 10 + 5, 1e-9);
}

TEST(EvaluateIntrinsics, CamerasWithoutPartnerAreReportedAndLeftOut) {
  FrameIntrinsics estimate = BetterEstimate();
  estimate.cameras.push_back(MakeCamera("10", {1, 1, 1, 1}));
  estimate.cameras.push_back(MakeCamera("9", {1, 1, 1, 1}));
  const FrameIntrinsics unknown = {"c", {MakeCamera("9", {1, 1, 1, 1})}};
  const Evaluation evaluation =
      EvaluateIntrinsics({estimate, unknown}, Truth());
  EXPECT_NEAR(evaluation.focal_abs.mean, 3, 1e-9);
  EXPECT_EQ(evaluation.num_cameras, 1);
  EXPECT_EQ(evaluation.missing_cameras, std::vector<std::string>{"2"});
  EXPECT_EQ(evaluation.extra_cameras, (std::vector<std::string>{"9", "10"}));
  EXPECT_EQ(evaluation.skipped_frames, std::vector<std::string>{"c"});
  EXPECT_EQ(evaluation.frames.size(), 1);
}

TEST(EvaluateIntrinsics, SeveralImagesOfOneCamera) {
  FrameIntrinsics estimate = GoodEstimate();
  estimate.cameras.push_back(estimate.cameras[0]);
  EXPECT_NEAR(
      EvaluateIntrinsics({estimate}, Truth()).focal_abs.mean, 12.5, 1e-9);

  estimate.cameras.back().params[0] += 1e-9;
  const std::string message = ErrorMessage({estimate}, Truth());
  EXPECT_TRUE(Contains(message, "Camera '1' of frame 'a'")) << message;
}

TEST(EvaluateIntrinsics, ImageSizes) {
  std::vector<CameraIntrinsics> truth = Truth();
  truth[0].width = truth[0].height = 0;
  EXPECT_NEAR(
      EvaluateIntrinsics({GoodEstimate()}, truth).pp_rel.mean, 7.5, 1e-9);

  truth[0].width = 2000;
  truth[0].height = 1000;
  const std::string message = ErrorMessage({GoodEstimate()}, truth);
  EXPECT_TRUE(Contains(message, "1000 x 500")) << message;
  EXPECT_TRUE(Contains(message, "2000 x 1000")) << message;
}

TEST(EvaluateIntrinsics, BadInput) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::string message =
      ErrorMessage({{"", {MakeCamera("7", {1, 1, 1, 1})}}}, Truth());
  EXPECT_TRUE(Contains(message, "'7'; of the ground truth: '1', '2'"))
      << message;
  EXPECT_NE(ErrorMessage({}, Truth()), "");
  EXPECT_NE(ErrorMessage({GoodEstimate()}, {}), "");
  const auto bad_camera_1 = [](const CameraIntrinsics& camera) {
    return ErrorMessage({GoodEstimate()}, {camera}) != "" &&
           ErrorMessage({{"", {camera}}}, Truth()) != "";
  };
  EXPECT_FALSE(bad_camera_1(MakeCamera("1", {1000, 1000, 500, 250})));
  EXPECT_TRUE(bad_camera_1(MakeCamera("1", {1000, nan, 500, 250})));
  EXPECT_TRUE(bad_camera_1(MakeCamera("1", {1000, 0, 500, 250})));
  EXPECT_TRUE(bad_camera_1(MakeCamera("1", {1000, 500, 250})));
  EXPECT_TRUE(bad_camera_1({"1", nullptr, 1000, 500, {}}));
}

TEST(ProjectionRms, PrincipalPointShift) {
  const Evaluation evaluation = EvaluateIntrinsics(
      {{"", {MakeCamera("1", {1000, 1000, 503, 254}), Truth()[1]}}}, Truth());
  EXPECT_NEAR(*evaluation.projection_rms_mean_px, 5 / 2.0, 1e-9);
  EXPECT_NEAR(*evaluation.projection_rms_max_px, 5, 1e-9);
}

TEST(ProjectionRms, Distortion) {
  const double k = 0.1;
  const Evaluation evaluation = EvaluateIntrinsics(
      {{"", {MakeCamera("1", {1000, 500, 250, k}, "SIMPLE_RADIAL")}}}, Truth());
  EXPECT_NEAR(evaluation.focal_abs.mean, 0, 1e-9);
  double sum_squares = 0;
  for (int row = 0; row < 12; ++row) {
    for (int col = 0; col < 16; ++col) {
      const double radius = std::hypot((col + 0.5) * 1000 / 16 - 500,
                                       (row + 0.5) * 500 / 12 - 250);
      sum_squares += std::pow(1000 * k * std::pow(radius / 1000, 3), 2);
    }
  }
  EXPECT_NEAR(*evaluation.projection_rms_mean_px,
              std::sqrt(sum_squares / (16 * 12)),
              1e-9);
}

TEST(ProjectionRms, SameLensInDifferentModels) {
  const Evaluation evaluation = EvaluateIntrinsics(
      {{"", {MakeCamera("1", {1000, 500, 250, -0.2, 0.1}, "RADIAL")}}},
      {MakeCamera("1", {1000, 1000, 500, 250, -0.2, 0.1, 0, 0}, "OPENCV")});
  EXPECT_NEAR(*evaluation.projection_rms_max_px, 0, 1e-6);
}

TEST(ProjectionRms, PointsTheTrueLensCannotSeeAreLeftOut) {
  // Image radii above 0.385 * 500 px belong to no ray.
  const CameraIntrinsics camera =
      MakeCamera("1", {500, 500, 250, -1}, "SIMPLE_RADIAL");
  const Evaluation evaluation = EvaluateIntrinsics({{"", {camera}}}, {camera});
  EXPECT_LT(evaluation.projection_rms_max_px.value(), 0.01);
}

TEST(EvaluationToJson, OneEstimate) {
  const nlohmann::ordered_json json =
      EvaluationToJson(EvaluateIntrinsics({GoodEstimate()}, Truth()));
  EXPECT_EQ(json["schema_version"], 1);
  EXPECT_NEAR(json["focal_abs"]["mean"].get<double>(), 12.5, 1e-9);
  for (const char* metric : {"focal_abs", "focal_rel", "pp_abs", "pp_rel"}) {
    EXPECT_TRUE(json[metric].at("mean").is_number());
    EXPECT_TRUE(json[metric].at("max").is_null());
    EXPECT_TRUE(json[metric].at("min").is_null());
  }
  EXPECT_NEAR(json["per_axis"]["fx"]["px"]["p95"].get<double>(), 9.75, 1e-9);
  EXPECT_NEAR(
      json["per_axis"]["fy"]["permille"]["median"].get<double>(), 5, 1e-9);
  EXPECT_NEAR(json["per_axis"]["cy"]["px"]["max"].get<double>(), 4, 1e-9);
  EXPECT_FALSE(json["per_axis"]["cx"].contains("permille"));
  EXPECT_NEAR(
      json["common"]["focal_scale_permille"]["mean"].get<double>(), 2.5, 1e-9);
  EXPECT_NEAR(json["common"]["pp_shift_y_px"]["mean"].get<double>(), -1, 1e-9);
  EXPECT_NEAR(json["rest"]["focal_rel"]["mean"].get<double>(), 15, 1e-9);
  EXPECT_NEAR(json["rest"]["pp_abs"]["mean"].get<double>(), 4.5, 1e-9);
  EXPECT_EQ(json["num_cameras"], 2);
  EXPECT_EQ(json["num_frames"], 1);
  EXPECT_TRUE(json["missing_cameras"].empty());
  EXPECT_TRUE(json["frames"].empty());
  ASSERT_EQ(json["cameras"].size(), 2);
  EXPECT_EQ(json["cameras"][0]["name"], "1");
  EXPECT_NEAR(json["cameras"][0]["fy_error"].get<double>(), -10, 1e-9);
  EXPECT_NEAR(json["cameras"][1]["cy_error_permille"].get<double>(), 4, 1e-9);
}

TEST(EvaluationToJson, SeveralFrames) {
  const nlohmann::ordered_json json = EvaluationToJson(
      EvaluateIntrinsics({GoodEstimate(), BetterEstimate()}, Truth()));
  EXPECT_NEAR(json["focal_rel"]["max"].get<double>(), 15, 1e-9);
  EXPECT_NEAR(json["focal_rel"]["min"].get<double>(), 3, 1e-9);
  EXPECT_EQ(json["num_frames"], 2);
  EXPECT_TRUE(json["cameras"].empty());
  ASSERT_EQ(json["frames"].size(), 2);
  EXPECT_EQ(json["frames"][1]["name"], "b");
  EXPECT_EQ(json["frames"][1]["num_cameras"], 1);
  EXPECT_NEAR(json["frames"][1]["focal_abs"].get<double>(), 3, 1e-9);
}

TEST(EvaluationToJson, NonFiniteNumbersBecomeNull) {
  const double huge = std::numeric_limits<double>::max();
  const nlohmann::ordered_json json = EvaluationToJson(EvaluateIntrinsics(
      {{"", {MakeCamera("1", {huge, huge, 500, 250})}}}, Truth()));
  EXPECT_TRUE(json["focal_abs"]["mean"].is_null());
  EXPECT_TRUE(json["projection_rms_px"]["mean"].is_null());
  EXPECT_NEAR(json["pp_abs"]["mean"].get<double>(), 0, 1e-9);
}

TEST(PrintEvaluation, ShowsNumbersAndNames) {
  FrameIntrinsics estimate = GoodEstimate();
  estimate.cameras.push_back(MakeCamera("spare", {1, 1, 1, 1}));
  std::ostringstream stream;
  PrintEvaluation(EvaluateIntrinsics({estimate}, Truth()), stream);
  const std::string text = stream.str();
  for (const char* part :
       {"2 of 2 cameras", "12.500", "15.000", "+2.500", "-1.000", "spare"}) {
    EXPECT_TRUE(Contains(text, part)) << part << " in\n" << text;
  }
}

}  // namespace
}  // namespace mfir
