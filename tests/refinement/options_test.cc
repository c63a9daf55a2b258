#include "src/refinement/options.h"

#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

void ExpectRefused(const MultiFrameOptions& options, const std::string& name) {
  try {
    options.Check();
    ADD_FAILURE() << name << " is not refused";
  } catch (const UsageError& error) {
    EXPECT_NE(std::string(error.what()).find("--MultiFrame." + name),
              std::string::npos)
        << error.what();
  }
}

struct DoubleOption {
  const char* name;
  double MultiFrameOptions::*member;
};

class DoubleOptionTest : public testing::TestWithParam<DoubleOption> {};

INSTANTIATE_TEST_SUITE_P(
    All,
    DoubleOptionTest,
    testing::Values(
        DoubleOption{"rotation_prior_weight",
                     &MultiFrameOptions::rotation_prior_weight},
        DoubleOption{"translation_prior_weight",
                     &MultiFrameOptions::translation_prior_weight},
        DoubleOption{"featuremetric_weight",
                     &MultiFrameOptions::featuremetric_weight},
        DoubleOption{"focal_variance_weight",
                     &MultiFrameOptions::focal_variance_weight},
        DoubleOption{"principal_point_variance_weight",
                     &MultiFrameOptions::principal_point_variance_weight},
        DoubleOption{"extra_params_variance_weight",
                     &MultiFrameOptions::extra_params_variance_weight},
        DoubleOption{"max_prior_weight", &MultiFrameOptions::max_prior_weight},
        DoubleOption{"held_out_share", &MultiFrameOptions::held_out_share},
        DoubleOption{"extrinsics_rotation_std_deg",
                     &MultiFrameOptions::extrinsics_rotation_std_deg},
        DoubleOption{"extrinsics_translation_std",
                     &MultiFrameOptions::extrinsics_translation_std},
        DoubleOption{"prior_focal_std", &MultiFrameOptions::prior_focal_std},
        DoubleOption{"prior_principal_point_std",
                     &MultiFrameOptions::prior_principal_point_std},
        DoubleOption{"loss_scale", &MultiFrameOptions::loss_scale}),
    [](const auto& info) { return info.param.name; });

TEST_P(DoubleOptionTest, RefusesNanInfinityAndNegativeValues) {
  for (const double value : {kNaN, kInf, -kInf, -1e-9, -1.0}) {
    MultiFrameOptions options;
    options.*GetParam().member = value;
    ExpectRefused(options, GetParam().name);
  }
}

TEST(MultiFrameOptions, MinInformationMayBeAutomatic) {
  MultiFrameOptions options;
  for (const double value : {-1.0, 0.0, 1e-6}) {
    options.min_information = value;
    EXPECT_NO_THROW(options.Check());
  }
  for (const double value : {kNaN, kInf, -0.5, -2.0}) {
    options.min_information = value;
    ExpectRefused(options, "min_information");
  }
}

TEST_P(DoubleOptionTest, AcceptsZero) {
  MultiFrameOptions options;
  options.*GetParam().member = 0.0;
  EXPECT_NO_THROW(options.Check());
}

TEST(MultiFrameOptions, DefaultsPass) {
  MultiFrameOptions options;
  EXPECT_NO_THROW(options.Check());
  options.ApplyPreset("accurate");
  EXPECT_NO_THROW(options.Check());
  options.ApplyPreset("paper");
  EXPECT_NO_THROW(options.Check());
}

TEST(MultiFrameOptions, RefusesWhatHasNoSense) {
  const auto refused = [](const char* name, auto member, auto value) {
    MultiFrameOptions options;
    options.*member = value;
    ExpectRefused(options, name);
  };
  using Options = MultiFrameOptions;
  for (const double value : {kNaN, kInf, -1.0, 0.0}) {
    refused("reprojection_weight", &Options::reprojection_weight, value);
  }
  for (const double value : {kNaN, kInf, -2.0, 0.0, 0.5, 1.0}) {
    refused("weight_growth", &Options::weight_growth, value);
  }
  for (const int value : {0, -1}) {
    refused("max_num_iterations", &Options::max_num_iterations, value);
  }
  for (const int value : {-2, 2}) {
    refused("use_gpu", &Options::use_gpu, value);
  }
  refused("gpu_index", &Options::gpu_index, -2);
  for (const int value : {-2}) {
    refused("num_threads", &Options::num_threads, value);
  }
  for (const char* value : {"", "Paper", "fast"}) {
    refused("preset", &Options::preset, std::string(value));
  }
  for (const char* value : {"", "Merge", "remove"}) {
    refused("static_points", &Options::static_points, std::string(value));
  }
  for (const char* value : {"SIFT", "superpoint"}) {
    refused("dense_features", &Options::dense_features, std::string(value));
  }
  MultiFrameOptions options;
  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  ExpectRefused(options, "refine_focal_length");
  options.refine_extra_params = true;
  EXPECT_NO_THROW(options.Check());
}

TEST(MultiFrameOptions, PriorsOnIntrinsicsNeedPriorIntrinsics) {
  for (const auto member : {&MultiFrameOptions::prior_focal_std,
                            &MultiFrameOptions::prior_principal_point_std}) {
    MultiFrameOptions options;
    options.*member = 5.0;
    ExpectRefused(options, "use_prior_intrinsics");
    options.use_prior_intrinsics = true;
    EXPECT_NO_THROW(options.Check());
  }
}

TEST(MultiFrameOptions, HeldOutTracksNeedALastSolveOnly) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.held_out_share = 0.1;
  EXPECT_NO_THROW(options.Check());
  options.held_out_share = 0.51;
  ExpectRefused(options, "held_out_share");
  options.ApplyPreset("paper");
  options.held_out_share = 0.1;
  ExpectRefused(options, "held_out_share");
}

TEST(MultiFrameOptions, NewTracksNeedALastSolveOnly) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  EXPECT_EQ(options.retriangulation_rounds, 2);
  options.retriangulation_rounds = -1;
  ExpectRefused(options, "retriangulation_rounds");
  options.ApplyPreset("paper");
  EXPECT_EQ(options.retriangulation_rounds, 0);
  options.retriangulation_rounds = 1;
  ExpectRefused(options, "retriangulation_rounds");
}

TEST(MultiFrameOptions, StaticPointsStayInSchedulesAndSingleFrames) {
  MultiFrameOptions options;
  options.ApplyPreset("paper");
  EXPECT_EQ(options.static_points, "keep");
  options.static_points = "merge";
  ExpectRefused(options, "static_points");
  options.ApplyPreset("accurate");
  EXPECT_NO_THROW(options.Check());
  options.static_points = "drop";
  EXPECT_NO_THROW(options.Check());
  options.focal_variance_weight = 0.0;
  options.principal_point_variance_weight = 0.0;
  ExpectRefused(options, "static_points");
  options.static_points = "keep";
  EXPECT_NO_THROW(options.Check());
}

TEST(MultiFrameOptions, MessageNamesValueAndBound) {
  MultiFrameOptions options;
  options.loss_scale = -0.5;
  try {
    options.Check();
    FAIL();
  } catch (const UsageError& error) {
    EXPECT_NE(std::string(error.what()).find("-0.5"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find(">= 0"), std::string::npos);
    EXPECT_EQ(error.exit_code, kExitUsage);
  }
  options = {};
  options.weight_growth = 1.0;
  try {
    options.Check();
    FAIL();
  } catch (const UsageError& error) {
    EXPECT_NE(std::string(error.what()).find("1.01"), std::string::npos);
  }
}

TEST(MultiFrameOptions, PaperPresetHasThePapersSettings) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.ApplyPreset("paper");
  EXPECT_EQ(options.preset, "paper");
  EXPECT_EQ(options.reprojection_weight, 1.0);
  EXPECT_EQ(options.rotation_prior_weight, 0.01);
  EXPECT_EQ(options.translation_prior_weight, 0.01);
  EXPECT_EQ(options.featuremetric_weight, 0.01);
  EXPECT_EQ(options.focal_variance_weight, 0.02);
  EXPECT_EQ(options.principal_point_variance_weight, 0.02);
  EXPECT_EQ(options.extra_params_variance_weight, 0.02);
  EXPECT_EQ(options.weight_growth, 2.0);
  EXPECT_EQ(options.max_prior_weight, 1e6);
  EXPECT_EQ(options.loss_scale, 0.25);
  EXPECT_TRUE(options.progressive);
  EXPECT_EQ(options.NumScheduleSolves(), 27);
}

TEST(MultiFrameOptions, AccuratePresetTakesTheLossFromTheData) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  EXPECT_EQ(options.preset, "accurate");
  EXPECT_EQ(options.loss_scale, 0.0);
  EXPECT_EQ(options.NumScheduleSolves(), 0);
}

TEST(MultiFrameOptions, UnknownPresetIsRefusedAndChangesNothing) {
  MultiFrameOptions options;
  options.ApplyPreset("paper");
  EXPECT_THROW(options.ApplyPreset("Accurate"), UsageError);
  EXPECT_THROW(options.ApplyPreset(""), UsageError);
  EXPECT_EQ(options.preset, "paper");
  EXPECT_EQ(options.max_prior_weight, 1e6);
}

// Number of solves by counting them: weights grow after each solve until a
// prior weight exceeds the maximum.
int CountSolves(const MultiFrameOptions& options) {
  int count = 0;
  for (double weight = options.rotation_prior_weight;
       weight <= options.max_prior_weight;
       weight *= options.weight_growth) {
    ++count;
  }
  return count;
}

TEST(NumScheduleSolves, CountsTheWeightsUpToTheMaximum) {
  for (const double growth : {1.5, 2.0, 3.0, 10.0}) {
    for (const double weight : {0.01, 1.0, 3.0}) {
      for (const double max_weight : {1.0, 27.0, 64.0, 1000.0, 1e6}) {
        MultiFrameOptions options;
        options.weight_growth = growth;
        options.rotation_prior_weight = weight;
        options.max_prior_weight = max_weight;
        EXPECT_EQ(options.NumScheduleSolves(), CountSolves(options))
            << weight << " x " << growth << " up to " << max_weight;
      }
    }
  }
}

TEST(NumScheduleSolves, NonProgressiveIsOne) {
  for (const char* preset : {"paper", "accurate"}) {
    MultiFrameOptions options;
    options.ApplyPreset(preset);
    options.progressive = false;
    EXPECT_EQ(options.NumScheduleSolves(), 1);
  }
}

TEST(NumScheduleSolves, ZeroPriorWeights) {
  MultiFrameOptions options;
  options.rotation_prior_weight = 0.0;  // the translation's counts
  EXPECT_EQ(options.NumScheduleSolves(), 27);
  options.translation_prior_weight = 0.0;  // nothing to grow
  EXPECT_EQ(options.NumScheduleSolves(), 1);
  options.max_prior_weight = 0.0;
  EXPECT_EQ(options.NumScheduleSolves(), 0);
  options.rotation_prior_weight = 0.01;
  options.max_prior_weight = 1e6;
  EXPECT_EQ(options.NumScheduleSolves(), 27);
}

TEST(MultiFrameOptions, SingleFrameModeNeedsBothWeightsZero) {
  MultiFrameOptions options;
  EXPECT_FALSE(options.SingleFrameMode());
  options.focal_variance_weight = 0.0;
  EXPECT_FALSE(options.SingleFrameMode());
  options.principal_point_variance_weight = 0.0;
  EXPECT_TRUE(options.SingleFrameMode());
}

TEST(MultiFrameOptions, EffectiveNumThreads) {
  MultiFrameOptions options;
  EXPECT_GE(options.EffectiveNumThreads(), 1);
  options.num_threads = 3;
  EXPECT_EQ(options.EffectiveNumThreads(), 3);
}

}  // namespace
}  // namespace mfir
