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

TEST(MultiFrameOptions, SchedulesKeepTheirKeypoints) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.refine_keypoints = 1;
  options.complete_tracks = 1;
  EXPECT_NO_THROW(options.Check());
  options.ApplyPreset("paper");
  ExpectRefused(options, "refine_keypoints");
  options.refine_keypoints = 0;
  ExpectRefused(options, "complete_tracks");
  options.complete_tracks = -1;
  EXPECT_NO_THROW(options.Check());
  options.complete_tracks = 2;
  ExpectRefused(options, "complete_tracks");
  options.complete_tracks = -2;
  ExpectRefused(options, "complete_tracks");
}

}  // namespace
}  // namespace mfir
