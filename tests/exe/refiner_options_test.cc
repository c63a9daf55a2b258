// Every option of the refiner reaches what it is for.

#include "colmap_ext/host/reconstruction.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class RefinerOptionsTest : public RefinerTest {
 protected:
  // A capture with distortion, small enough for the schedule of the paper.
  static void SetUpTestSuite() {
    original_ = new TemporaryFolder;
    SimulatorOptions options = SmallCapture();
    options.num_cameras = 5;
    options.azimuth = 40.0;
    options.num_frames = 2;
    options.num_points = 60;
    options.camera_model = "SIMPLE_RADIAL";
    WriteSimulatedCapture(SimulateCapture(options), *original_ / "capture");
  }

  // The first solves of the schedule.
  static CommandOptions Paper() {
    return {{"MultiFrame.preset", "paper"},
            {"MultiFrame.max_prior_weight", "0.02"},
            {"MultiFrame.max_num_iterations", "40"}};
  }

  static CommandOptions With(CommandOptions options,
                             const CommandOptions& more) {
    for (const auto& [name, value] : more) options[name] = value;
    return options;
  }
};

TEST_F(RefinerOptionsTest, EveryOptionChangesTheResult) {
  struct Case {
    std::string name;
    std::string value;
    CommandOptions base;
  };
  // Of the schedule: with the paper's settings.
  const std::vector<Case> cases = {
      {"preset", "paper", {{"MultiFrame.max_prior_weight", "0.05"}}},
      {"reprojection_weight", "0.2", Paper()},
      {"rotation_prior_weight", "0.03", Paper()},
      {"translation_prior_weight", "0.03", Paper()},
      {"focal_variance_weight", "0.5", Paper()},
      {"principal_point_variance_weight", "0.5", Paper()},
      {"extra_params_variance_weight", "0.5", Paper()},
      {"weight_growth", "1.5", Paper()},
      {"max_prior_weight", "0.05", Paper()},
      {"progressive", "0", Paper()},
      {"loss_scale", "1", Paper()},
      {"loss_scale", "1", {}},
      {"max_num_frames", "1", {}},
      {"refine_focal_length", "0", {}},
      {"refine_principal_point", "0", {}},
      {"refine_extra_params", "0", {}},
      {"use_prior_intrinsics", "1", {{"MultiFrame.refine_focal_length", "0"}}},
      {"camera_model", "OPENCV", {}}};
  std::map<CommandOptions, CameraParams> base_params;
  for (const Case& c : cases) {
    if (base_params.count(c.base) == 0) {
      Refine(c.base);
      base_params[c.base] = Params();
    }
    fs::remove_all(Path("out"));
    Refine(With(c.base, {{"MultiFrame." + c.name, c.value}}));
    EXPECT_GT(MaxRelativeDifference(base_params[c.base], Params()), 1e-9)
        << c.name << "=" << c.value;
  }
}

TEST_F(RefinerOptionsTest, OptionsThatChangeNoNumber) {
  EXPECT_NE(Refine().output, "");
  EXPECT_EQ(Refine({{"MultiFrame.quiet", "1"},
                    {"ground_truth_path", Path("ground_truth")}})
                .output,
            "");
  EXPECT_EQ(Refine({{"MultiFrame.max_num_iterations", "1"}}).exit_code,
            kExitSolver);
  EXPECT_EQ(Refine({{"MultiFrame.camera_name_regex", "(c)am"}}).exit_code,
            kExitBadInput);
  EXPECT_EQ(Refine({{"MultiFrame.dense_features", "none"}}).exit_code,
            kExitSuccess);
  // Each says what it needs.
  const std::vector<std::pair<std::string, std::string>> needs = {
      {"sift", "image_path"},
      {"onnx", "onnx_path"},
      {"database", "dense_feature_path"}};
  for (const auto& [features, option] : needs) {
    const CommandResult result =
        Refine({{"MultiFrame.dense_features", features}});
    EXPECT_EQ(result.exit_code, kExitUsage) << features;
    EXPECT_NE(result.error.find(option), std::string::npos) << result.error;
  }
  // Nothing would use them.
  for (const char* name : {"use_gpu", "gpu_index"}) {
    const CommandResult result =
        Refine({{std::string("MultiFrame.") + name, "1"}});
    EXPECT_EQ(result.exit_code, kExitUsage);
    EXPECT_NE(result.error.find(name), std::string::npos) << result.error;
  }
  // Nothing to weigh: said once, unless the weight is zero.
  EXPECT_NE(Refine().output.find("featuremetric_weight weighs nothing"),
            std::string::npos);
  EXPECT_EQ(Refine({{"MultiFrame.featuremetric_weight", "0"}})
                .output.find("featuremetric_weight"),
            std::string::npos);
}

// On where there are images, off with the paper's settings; without an image of
// its own a frame keeps its keypoints.
TEST_F(RefinerOptionsTest, KeypointsAreRefinedWhereThereAreImages) {
  fs::create_directories(Path("no_images"));
  ExpectRefines();
  EXPECT_EQ(Summary()["options"]["MultiFrame.refine_keypoints"], 0);
  const CommandResult result = Refine({{"image_path", Path("no_images")},
                                       {"MultiFrame.dense_features", "none"}});
  EXPECT_EQ(result.exit_code, kExitSuccess) << result.error;
  EXPECT_NE(result.output.find("keeps its keypoints"), std::string::npos)
      << result.output;
  EXPECT_EQ(Summary()["options"]["MultiFrame.refine_keypoints"], 1);
  EXPECT_EQ(Summary()["options"]["MultiFrame.complete_tracks"], 1);
  ExpectRefines({{"image_path", Path("no_images")},
                 {"MultiFrame.dense_features", "none"},
                 {"MultiFrame.preset", "paper"}});
  EXPECT_EQ(Summary()["options"]["MultiFrame.complete_tracks"], 0);
}

TEST_F(RefinerOptionsTest, KeypointsAreRefinedWhereTheUserSays) {
  fs::create_directories(Path("no_images"));
  const auto refine = [&](const std::string& use_gpu) {
    return Refine({{"image_path", Path("no_images")},
                   {"MultiFrame.dense_features", "none"},
                   {"MultiFrame.use_gpu", use_gpu}});
  };
  const std::string line = "Keypoints are refined on ";
  const CommandResult any = refine("-1");
  EXPECT_EQ(any.exit_code, kExitSuccess) << any.error;
  EXPECT_NE(any.output.find(line), std::string::npos) << any.output;
  const CommandResult cpu = refine("0");
  EXPECT_EQ(cpu.exit_code, kExitSuccess) << cpu.error;
  EXPECT_EQ(cpu.output.find(line), std::string::npos) << cpu.output;
  const CommandResult gpu = refine("1");
  if (any.output.find(line + "the CPU") == std::string::npos) {
    EXPECT_EQ(gpu.exit_code, kExitSuccess) << gpu.error;
  } else {
    EXPECT_EQ(gpu.exit_code, kExitUsage);
    EXPECT_NE(gpu.error.find("use_gpu=1: "), std::string::npos) << gpu.error;
  }
}

TEST_F(RefinerOptionsTest, AllOptionsLandInSummaryAndProjectFile) {
  ExpectRefines({{"MultiFrame.num_threads", "1"}});
  const nlohmann::json options = Summary()["options"];
  const std::string project = ReadFile(Path("out/project.ini"));
  for (const char* name : {"preset",
                           "reprojection_weight",
                           "rotation_prior_weight",
                           "translation_prior_weight",
                           "featuremetric_weight",
                           "focal_variance_weight",
                           "principal_point_variance_weight",
                           "extra_params_variance_weight",
                           "weight_growth",
                           "max_prior_weight",
                           "progressive",
                           "loss_scale",
                           "max_num_iterations",
                           "refine_focal_length",
                           "refine_principal_point",
                           "refine_extra_params",
                           "use_prior_intrinsics",
                           "static_points",
                           "camera_model",
                           "camera_name_regex",
                           "dense_features",
                           "use_gpu",
                           "gpu_index",
                           "num_threads",
                           "report",
                           "quiet"}) {
    EXPECT_TRUE(options.contains(std::string("MultiFrame.") + name)) << name;
  }
  for (const char* line :
       {"preset=accurate\n", "gpu_index=-1\n", "num_threads=1\n"}) {
    EXPECT_NE(project.find(line), std::string::npos) << line;
  }
}

TEST_F(RefinerOptionsTest, HeldParametersKeepTheirValues) {
  const auto expect_held = [this](const std::string& name,
                                  const std::vector<size_t>& held_idxs,
                                  const CommandOptions& more) {
    ExpectRefines(With(more,
                       {{"MultiFrame." + name, "0"},
                        {"MultiFrame.max_num_iterations", "500"}}));
    const CameraParams initial = Params("out", "params_initial");
    for (const auto& [camera, params] : Params()) {
      for (size_t i = 0; i < params.size(); ++i) {
        const bool held =
            std::find(held_idxs.begin(), held_idxs.end(), i) != held_idxs.end();
        EXPECT_EQ(params[i] == initial.at(camera)[i], held)
            << name << " " << camera << " " << i;
      }
    }
  };
  for (const CommandOptions& more : {CommandOptions(), Paper()}) {
    expect_held("refine_focal_length", {0}, more);
    expect_held("refine_principal_point", {1, 2}, more);
    expect_held("refine_extra_params", {3}, more);
  }
}

TEST_F(RefinerOptionsTest, PriorIntrinsicsAreTheStart) {
  ExpectRefines({{"MultiFrame.use_prior_intrinsics", "1"}});
  const host::Reconstruction rig = Read(Path("rig"));
  const CameraParams initial = Params("out", "params_initial");
  for (const auto& [id, image] : rig.Images()) {
    EXPECT_EQ(initial.at(image.Name().substr(0, 5)),
              host::Params(rig.Camera(image.CameraId())));
  }
  // RIG of another model.
  const CommandResult result = Refine({{"MultiFrame.use_prior_intrinsics", "1"},
                                       {"MultiFrame.camera_model", "PINHOLE"}});
  EXPECT_EQ(result.exit_code, kExitBadInput);
  EXPECT_NE(result.error.find("camera_model"), std::string::npos);
}

TEST_F(RefinerOptionsTest, CameraModelConverts) {
  const std::vector<std::pair<std::string, size_t>> models = {
      {"SIMPLE_PINHOLE", 3},
      {"PINHOLE", 4},
      {"RADIAL", 5},
      {"OPENCV", 8},
      {"FULL_OPENCV", 12}};
  for (const auto& [model, num_params] : models) {
    // High orders of distortion need not be determined by so few points. What
    // did not converge does not replace another result.
    fs::remove_all(Path("out"));
    const CommandResult result = Refine({{"MultiFrame.camera_model", model}});
    EXPECT_TRUE(result.exit_code == kExitSuccess ||
                result.exit_code == kExitSolver)
        << model << result.error;
    const nlohmann::json summary = Summary();
    for (const nlohmann::json& camera : summary["cameras"]) {
      EXPECT_EQ(camera["model"], model);
      EXPECT_EQ(camera["params"].size(), num_params);
    }
    EXPECT_EQ(Read(Path("out/frames/frame000001")).Camera(1).ModelName(),
              model);
  }
  EXPECT_EQ(Refine({{"MultiFrame.camera_model", "opencv"}}).exit_code,
            kExitUsage);
}

TEST_F(RefinerOptionsTest, SingleFrameMode) {
  for (const CommandOptions& base : {CommandOptions(), Paper()}) {
    ExpectRefines(With(base,
                       {{"MultiFrame.focal_variance_weight", "0"},
                        {"MultiFrame.principal_point_variance_weight", "0"},
                        {"MultiFrame.max_num_iterations", "500"}}));
    // The noise that is reported is that of the keypoints (0.5 px).
    EXPECT_LT(Summary()["result"]["noise_std_px"], 1.0);
    const CameraParams joint = Params();
    std::vector<host::Reconstruction> frames = {
        Read(Path("out/frames/frame000000")),
        Read(Path("out/frames/frame000001"))};
    EXPECT_NE(host::Params(frames[0].Camera(1)),
              host::Params(frames[1].Camera(1)));
    for (int i = 1; i <= 5; ++i) {
      const double a = host::Params(frames[0].Camera(i))[0];
      const double b = host::Params(frames[1].Camera(i))[0];
      EXPECT_NEAR(
          joint.at("cam0" + std::to_string(i - 1))[0], 0.5 * (a + b), 1e-9 * a);
    }
  }
  // A frame of its own gives the same.
  WriteFile(Path("list"), "frame000001\n");
  ExpectRefines({{"MultiFrame.focal_variance_weight", "0"},
                 {"MultiFrame.principal_point_variance_weight", "0"}});
  const std::vector<double> in_both =
      host::Params(Read(Path("out/frames/frame000001")).Camera(2));
  ExpectRefines({{"frame_list_path", Path("list")}});
  EXPECT_NEAR(Params().at("cam01")[0], in_both[0], 1e-6 * in_both[0]);
}

TEST_F(RefinerOptionsTest, PaperPresetFromEndToEnd) {
  const CommandResult result = Refine({{"MultiFrame.preset", "paper"}});
  EXPECT_TRUE(result.exit_code == kExitSuccess ||
              result.exit_code == kExitSolver)
      << result.error;
  const nlohmann::json summary = Summary();
  size_t num_schedule = 0;
  double weight = 0.01;
  for (const nlohmann::json& stage : summary["stages"]) {
    if (stage["name"] != "schedule") continue;
    EXPECT_DOUBLE_EQ(stage["weights"]["rotation_prior"], weight);
    EXPECT_DOUBLE_EQ(stage["weights"]["focal_variance"], 2.0 * weight);
    for (const char* term : {"reprojection",
                             "rotation_prior",
                             "translation_prior",
                             "focal_variance",
                             "principal_point_variance"}) {
      EXPECT_GE(stage["cost"][term], 0.0) << term;
    }
    weight *= 2.0;
    ++num_schedule;
  }
  EXPECT_EQ(num_schedule, 27);
  EXPECT_EQ(summary["options"]["MultiFrame.loss_scale"], 0.25);
  EXPECT_NE(result.output.find("27 / 27"), std::string::npos);
  // Explicit options win over the preset, wherever they stand.
  const CommandResult baseline =
      Refine(With(Paper(), {{"MultiFrame.max_prior_weight", "0"}}));
  EXPECT_EQ(baseline.output.find("schedule"), std::string::npos);
  EXPECT_EQ(Summary()["options"]["MultiFrame.loss_scale"], 0.25);
}

TEST_F(RefinerOptionsTest, NotProgressiveIsOneSoftSolve) {
  ExpectRefines({{"MultiFrame.preset", "paper"},
                 {"MultiFrame.progressive", "0"},
                 {"MultiFrame.max_num_iterations", "300"}});
  const nlohmann::json summary = Summary();
  EXPECT_EQ(std::count_if(summary["stages"].begin(),
                          summary["stages"].end(),
                          [](const nlohmann::json& stage) {
                            return stage["name"] == "schedule";
                          }),
            1);
  // The extrinsics that are written are the known ones all the same.
  EXPECT_EQ(
      host::CamFromWorld(Read(Path("out/rig")).Image(2)).rotation.coeffs(),
      host::CamFromWorld(Read(Path("rig")).Image(2)).rotation.coeffs());
}

}  // namespace
}  // namespace mfir
