// The option static_points of the refiner, on a capture of two frames and a
// copy of the first.

#include <algorithm>

#include "colmap_ext/host/reconstruction.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

const char* const kFrame0 = "frame000000";
const char* const kFrame1 = "frame000001";
const char* const kCopy = "frame000000_copy";

class RefinerStaticPointsTest : public RefinerTest {
 protected:
  void SetUp() override {
    RefinerTest::SetUp();
    fs::remove_all(Path("frames/frame000002"));
    fs::copy(Path("frames/" + std::string(kFrame0)),
             Path("frames/" + std::string(kCopy)),
             fs::copy_options::recursive);
  }

  // Into a folder of this name. Returns what was printed.
  std::string RefineAs(const std::string& static_points,
                       CommandOptions options = {}) const {
    options["output_path"] = Path(static_points);
    options["MultiFrame.static_points"] = static_points;
    const CommandResult result = Refine(options);
    EXPECT_EQ(result.exit_code, kExitSuccess) << result.error;
    return result.output;
  }

  // Refines the frames of the list into the folder `output`.
  void RefineFrames(const std::string& frames,
                    const std::string& output,
                    CommandOptions options = {}) const {
    WriteFile(Path("list"), frames);
    options["frame_list_path"] = Path("list");
    options["output_path"] = Path(output);
    ExpectRefines(options);
  }

  std::vector<double> Stds(const std::string& output) const {
    std::vector<double> stds;
    for (const auto& [name, values] : Params(output, "params_std")) {
      stds.insert(stds.end(), values.begin(), values.end());
    }
    return stds;
  }
};

TEST_F(RefinerStaticPointsTest, MergedCopiesChangeNothing) {
  RefineFrames("frame000000\nframe000001\n", "without_copy");
  const std::string log = RefineAs("merge");
  EXPECT_LT(MaxRelativeDifference(Params("without_copy"), Params("merge")),
            1e-9);
  EXPECT_LT(MaxRelativeDifference(Params("without_copy", "params_std"),
                                  Params("merge", "params_std")),
            1e-6);
  EXPECT_NEAR(Summary("without_copy")["result"]["held_out_rms_px"],
              Summary("merge")["result"]["held_out_rms_px"],
              1e-6);

  const nlohmann::json summary = Summary("merge");
  const nlohmann::json& static_points = summary["result"]["static_points"];
  const size_t num_points = Read(ModelPath(kFrame0)).NumPoints3D();
  EXPECT_EQ(static_points["num_points"], num_points);
  EXPECT_EQ(static_points["num_tracks"], 2 * num_points);
  EXPECT_NEAR(static_points["observation_share"], 2.0 / 3.0, 0.03);
  EXPECT_NE(log.find("Static points: 150, 6"), std::string::npos) << log;
  EXPECT_NE(log.find("(static_points merge)"), std::string::npos) << log;
}

TEST_F(RefinerStaticPointsTest, AllTracksAreInTheResult) {
  for (const char* treatment : {"merge", "drop", "keep"}) {
    RefineAs(treatment);
    const std::string frames = treatment + std::string("/frames/");
    for (const char* frame : {kFrame0, kFrame1, kCopy}) {
      const host::Reconstruction before = Read(ModelPath(frame));
      const host::Reconstruction after = Read(Path(frames + frame));
      EXPECT_EQ(after.NumPoints3D(), before.NumPoints3D());
      EXPECT_EQ(after.ComputeNumObservations(),
                before.ComputeNumObservations());
      // Noise of 0.5 px, some outliers.
      EXPECT_LT(after.ComputeMeanReprojectionError(), 2.0)
          << treatment << frame;
    }
    // Held-out tracks of the two frames differ.
    if (treatment == std::string("keep")) continue;
    const host::Reconstruction frame = Read(Path(frames + kFrame0));
    const host::Reconstruction copy = Read(Path(frames + kCopy));
    for (const auto& [id, point] : frame.Points3D()) {
      EXPECT_LT((host::Xyz(copy.Point3D(id)) - host::Xyz(point)).norm(), 1e-6);
    }
  }
}

TEST_F(RefinerStaticPointsTest, CopiesAreEvidenceOnceDroppedOnesNot) {
  const CommandOptions options = {{"MultiFrame.held_out_share", "0"}};
  RefineFrames("frame000001\n", "frame1", options);
  RefineAs("drop", options);
  EXPECT_LT(MaxRelativeDifference(Params("frame1"), Params("drop")), 1e-4);
  RefineAs("keep", options);
  RefineAs("merge", options);
  const std::vector<double> kept = Stds("keep");
  const std::vector<double> merged = Stds("merge");
  const std::vector<double> dropped = Stds("drop");
  for (size_t i = 0; i < kept.size(); ++i) {
    // As independent frames it would be the root of 2/3, with the right weights
    // at least 1.
    EXPECT_GT(kept[i], 0.95 * merged[i]);
    EXPECT_LT(kept[i], 1.2 * merged[i]);
    EXPECT_LT(kept[i], dropped[i]);
  }
}

TEST_F(RefinerStaticPointsTest, KeptCopiesAreNoNewEvidence) {
  const CommandOptions options = {{"MultiFrame.held_out_share", "0"}};
  RefineFrames("frame000000\n", "one", options);
  RefineFrames("frame000000\nframe000000_copy\n", "twice", options);
  EXPECT_LT(MaxRelativeDifference(Params("one"), Params("twice")), 1e-8);
  EXPECT_LT(MaxRelativeDifference(Params("one", "params_std"),
                                  Params("twice", "params_std")),
            1e-5);
}

TEST_F(RefinerStaticPointsTest, ProjectFileSetsIt) {
  RefineAs("drop");
  WriteFile(Path("project.ini"), "[MultiFrame]\nstatic_points=drop\n");
  ExpectRefines({{"project_path", Path("project.ini")}});
  EXPECT_EQ(Params("out"), Params("drop"));
  // The default.
  RefineAs("keep");
  ExpectRefines();
  EXPECT_EQ(Params("out"), Params("keep"));
}

TEST_F(RefinerStaticPointsTest, DropWithNothingLeft) {
  const std::string log = RefineAs("drop");
  for (const char* frame : {kFrame0, kCopy}) {
    EXPECT_NE(log.find("Frame '" + std::string(frame) +
                       "' has static points only and takes no part"),
              std::string::npos)
        << log;
  }
  WriteFile(Path("list"), "frame000000\nframe000000_copy\n");
  ExpectError(kExitBadInput,
              {"static_points drop", "Use merge"},
              {{"frame_list_path", Path("list")},
               {"MultiFrame.static_points", "drop"}});
}

// The frame that moves has one image less.
TEST_F(RefinerStaticPointsTest, CameraThatSeesStaticPointsOnly) {
  ChangeFrame(kFrame1, [](host::Reconstruction* model) {
    KeepImages(model->NumRegImages() - 1, model);
  });
  const CommandResult result = Refine({{"MultiFrame.static_points", "drop"}});
  EXPECT_EQ(result.exit_code, kExitSuccess) << result.error;
  EXPECT_EQ(result.error.find("contradicts"), std::string::npos)
      << result.error;
  size_t num_without = 0;
  const nlohmann::json summary = Summary();
  for (const nlohmann::json& camera : summary["cameras"]) {
    const bool is_without = camera["params_std"][0].is_null();
    num_without += is_without;
    const nlohmann::json& flags = camera["flags"];
    EXPECT_EQ(std::count(flags.begin(), flags.end(), "no_observations"),
              is_without);
    EXPECT_EQ(std::count(flags.begin(), flags.end(), "contradicts_extrinsics"),
              0);
    EXPECT_EQ(camera["params"] == camera["params_initial"], is_without);
  }
  EXPECT_EQ(num_without, 1u);
}

TEST_F(RefinerStaticPointsTest, SchedulesAndSingleFramesKeep) {
  const std::vector<CommandOptions> cases = {
      {{"MultiFrame.preset", "paper"}, {"MultiFrame.max_prior_weight", "0.01"}},
      {{"MultiFrame.focal_variance_weight", "0"},
       {"MultiFrame.principal_point_variance_weight", "0"}}};
  for (CommandOptions options : cases) {
    EXPECT_NE(Refine(options).output.find("(static_points keep)"),
              std::string::npos);
    options["MultiFrame.static_points"] = "merge";
    ExpectError(kExitUsage, {"static_points must be keep"}, options);
  }
}

}  // namespace
}  // namespace mfir
