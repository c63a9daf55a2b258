// Real captures, where they exist.

#include "tests/support/refiner_runner.h"
#include "tests/support/test_data.h"

namespace mfir {
namespace {

class RealDataTest : public testing::Test {
 protected:
  // The summary of a run with ground truth = RIG = calibration.
  void Refine(const std::string& capture,
              const std::string& frames,
              const std::vector<std::string>& more = {}) {
    const auto path = TestDataFolder() / capture;
    std::vector<std::string> arguments = {"multi_frame_intrinsics_refiner",
                                          "--input_path",
                                          path / frames,
                                          "--extrinsics_path",
                                          path / "calibration",
                                          "--ground_truth_path",
                                          path / "calibration",
                                          "--output_path",
                                          folder_ / "out"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CommandResult result = RunColmap(arguments);
    ASSERT_EQ(result.exit_code, kExitSuccess) << result.error;
    summary_ = nlohmann::json::parse(ReadFile(folder_ / "out/summary.json"));
  }

  TemporaryFolder folder_;
  nlohmann::json summary_;
};

TEST_F(RealDataTest, Panoptic) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated");
  Refine("panoptic31", "frames_triangulated");
  EXPECT_EQ(summary_["cameras"].size(), 31);
  EXPECT_LE(summary_["evaluation"]["focal_rel"]["mean"], 1.4);
  EXPECT_LE(summary_["evaluation"]["pp_abs"]["mean"], 0.55);
}

// Once the last solve cycled here: a point in the centre of a camera, and steps
// that the cost could not judge.
TEST_F(RealDataTest, PanopticFromAStartFurtherOff) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated_drift2");
  Refine("panoptic31", "frames_triangulated_drift2");
  EXPECT_LE(summary_["result"]["last_step_stds"], 1e-4);
  EXPECT_LE(summary_["evaluation"]["focal_rel"]["mean"], 1.5);
  EXPECT_LE(summary_["evaluation"]["pp_abs"]["mean"], 0.55);
}

// Once it cycled in every solve: the polynomial of the lens folded a point far
// outside of the image into it.
TEST_F(RealDataTest, PanopticWithDistortion) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated");
  WriteFile(folder_ / "list",
            "000015\n000030\n000045\n000075\n000090\n000105\n000135\n");
  Refine("panoptic31",
         "frames_triangulated",
         {"--frame_list_path",
          folder_ / "list",
          "--MultiFrame.camera_model",
          "OPENCV"});
  EXPECT_LE(summary_["result"]["last_step_stds"], 1e-4);
}

TEST_F(RealDataTest, PanopticOneFrame) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated/000000");
  WriteFile(folder_ / "list", "000000\n");
  Refine("panoptic31",
         "frames_triangulated",
         {"--frame_list_path", folder_ / "list"});
  EXPECT_LE(summary_["evaluation"]["focal_rel"]["mean"], 3.0);
  EXPECT_LE(summary_["evaluation"]["pp_abs"]["mean"], 0.9);
}

// A point whose minimum vanishes, and comes back, and so on: a `start` solve
// went round in circles for 2000 iterations.
TEST_F(RealDataTest, PointsThatLoseTheirMinimaStayOut) {
  MFIR_REQUIRE_TEST_DATA("panoptic31/frames_triangulated/000060");
  WriteFile(folder_ / "list", "000060\n");
  Refine("panoptic31",
         "frames_triangulated",
         {"--frame_list_path",
          folder_ / "list",
          "--MultiFrame.camera_model",
          "FULL_OPENCV"});
  for (const nlohmann::json& stage : summary_["stages"]) {
    EXPECT_EQ(stage["termination"], "converged");
    EXPECT_LT(stage["iterations"], 300);
  }
}

TEST_F(RealDataTest, RobovisionTriangulated) {
  MFIR_REQUIRE_TEST_DATA("robovision12/frames_triangulated");
  Refine("robovision12", "frames_triangulated");
  EXPECT_EQ(summary_["cameras"].size(), 12);
  EXPECT_LT(summary_["result"]["rms_px_after"], 1.0);
}

TEST_F(RealDataTest, RobovisionStructureFromMotion) {
  MFIR_REQUIRE_TEST_DATA("robovision12/frames_sfm");
  Refine("robovision12", "frames_sfm");
  EXPECT_EQ(summary_["cameras"].size(), 12);
  EXPECT_LT(summary_["result"]["rms_px_after"], 1.0);
}

// Frames of few images, a start that is off by a factor of three, and a lens
// model of twelve parameters: `start` solves that crept along for thousands of
// iterations, and exit code 3.
TEST_F(RealDataTest, StartSolvesStopWhenGoodEnough) {
  MFIR_REQUIRE_TEST_DATA("robovision12/frames_sfm");
  WriteFile(folder_ / "list", "2016_10_24__17_44_40\n2016_10_24__18_26_46\n");
  Refine("robovision12",
         "frames_sfm",
         {"--frame_list_path",
          folder_ / "list",
          "--MultiFrame.camera_model",
          "FULL_OPENCV"});
  for (const nlohmann::json& stage : summary_["stages"]) {
    EXPECT_LT(stage["iterations"], 500);
  }
}

}  // namespace
}  // namespace mfir
