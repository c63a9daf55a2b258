// What the commands do with options that cannot work: exit code and message.

#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

using BadOptionsTest = RefinerTest;

TEST_F(BadOptionsTest, WrongValues) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"preset", "fast"},
      {"reprojection_weight", "0"},
      {"reprojection_weight", "nan"},
      {"rotation_prior_weight", "-1"},
      {"translation_prior_weight", "inf"},
      {"featuremetric_weight", "-1"},
      {"focal_variance_weight", "-1"},
      {"principal_point_variance_weight", "-0.1"},
      {"extra_params_variance_weight", "nan"},
      {"weight_growth", "1"},
      {"max_prior_weight", "-1"},
      {"progressive", "2"},
      {"loss_scale", "-1"},
      {"loss_scale", "1px"},
      {"loss_scale", "0,25"},
      {"max_num_iterations", "0"},
      {"max_num_iterations", "1.5"},
      {"max_num_iterations", "99999999999"},
      {"refine_focal_length", "maybe"},
      {"refine_principal_point", "3"},
      {"refine_extra_params", "x"},
      {"use_prior_intrinsics", "x"},
      {"static_points", "remove"},
      {"camera_model", "PINHOLES"},
      {"camera_name_regex", "("},
      {"camera_name_regex", "cam"},
      {"camera_name_regex", "(c)(a)"},
      {"dense_features", "sift"},
      {"dense_features", "foo"},
      {"use_gpu", "2"},
      {"use_gpu", "-2"},
      {"gpu_index", "-2"},
      {"num_threads", "0"},
      {"num_threads", "-2"},
      {"quiet", "loud"}};
  for (const auto& [name, value] : cases) {
    ExpectError(kExitUsage, {name}, {{"MultiFrame." + name, value}});
  }
  ExpectError(kExitUsage, {"format"}, {{"extrinsics_format", "bal"}});
  ExpectError(kExitUsage, {"format"}, {{"ground_truth_format", "bal"}});
  for (const char* offset : {"inf", "1e+300", "-20000"}) {
    ExpectError(kExitUsage,
                {"extrinsics_pixel_offset", offset},
                {{"extrinsics_pixel_offset", offset},
                 {"MultiFrame.use_prior_intrinsics", "1"}});
  }
  ExpectError(kExitUsage,
              {"is 0, but must be finite and >= 1e-12"},
              {{"MultiFrame.reprojection_weight", "0"}});
  ExpectError(kExitUsage,
              {"refine_focal_length"},
              {{"MultiFrame.refine_focal_length", "0"},
               {"MultiFrame.refine_principal_point", "0"},
               {"MultiFrame.refine_extra_params", "0"}});
  // More threads than any machine has: an error or fewer threads, no crash.
  for (const char* threads : {"100000", "2147483647"}) {
    const int code =
        Refine({{"MultiFrame.num_threads", threads}}, 20).exit_code;
    EXPECT_TRUE(code == kExitSuccess || code == kExitUsage) << code;
  }
}

TEST_F(BadOptionsTest, UnknownOptions) {
  ExpectError(
      kExitUsage, {"MultiFrame.nonsense"}, {{"MultiFrame.nonsense", "1"}});
  // COLMAP would take an abbreviation.
  ExpectError(kExitUsage,
              {"MultiFrame.loss_scal", "Did you mean", "loss_scale"},
              {{"MultiFrame.loss_scal", "1"}});
  ExpectError(kExitUsage, {"input_pat", "input_path"}, {{"input_pat", "x"}});
  // A forgotten "--name".
  const CommandResult result = RunColmap({"multi_frame_intrinsics_refiner",
                                          "stray",
                                          "--input_path",
                                          Path("frames"),
                                          "--extrinsics_path",
                                          Path("rig"),
                                          "--output_path",
                                          Path("out")});
  EXPECT_EQ(result.exit_code, kExitUsage);
  EXPECT_NE(result.error.find("stray"), std::string::npos) << result.error;
}

TEST_F(BadOptionsTest, ProjectFiles) {
  const auto expect_error = [this](const std::string& content,
                                   const std::vector<std::string>& parts) {
    WriteFile(Path("project.ini"), content);
    ExpectError(kExitUsage, parts, {{"project_path", Path("project.ini")}});
  };
  expect_error("[MultiFrame]\nloss_scal=1\n",
               {"project.ini:2", "loss_scal", "loss_scale"});
  expect_error("[MultiFrame]\nloss_scale=1\nloss_scale=2\n", {"twice"});
  expect_error("[MultiFrame]\nloss_scale=much\n", {"loss_scale", "much"});
  expect_error("[MultiFrame]\npreset=fast\n", {"preset", "fast"});
  expect_error("nonsense\n", {"project.ini", "nonsense"});
  expect_error("[MultiFrame\nloss_scale=1\n", {"project.ini"});
  expect_error("input_pth=x\n", {"project.ini:1", "input_pth", "input_path"});
  // A section that only its case tells from ours.
  expect_error("[Multiframe]\nloss_scale=1\n", {"Multiframe"});
  ExpectError(kExitUsage, {folder_.Path()}, {{"project_path", folder_.Path()}});
}

TEST_F(BadOptionsTest, Evaluator) {
  const auto evaluate = [this](const CommandOptions& options) {
    CommandOptions all = {{"input_path", Path("frames")},
                          {"ground_truth_path", Path("ground_truth")}};
    for (const auto& [name, value] : options) all[name] = value;
    std::vector<std::string> arguments = {"multi_frame_evaluator"};
    for (const auto& [name, value] : all) {
      arguments.insert(arguments.end(), {"--" + name, value});
    }
    return RunColmap(arguments).exit_code;
  };
  EXPECT_EQ(evaluate({}), kExitSuccess);
  const std::string too_long = Path(std::string(300, 'x'));
  EXPECT_EQ(evaluate({{"input_path", Path("missing")}}), kExitBadInput);
  EXPECT_EQ(evaluate({{"input_path", too_long}}), kExitBadInput);
  EXPECT_EQ(evaluate({{"ground_truth_path", Path("missing")}}), kExitBadInput);
  EXPECT_EQ(evaluate({{"output_path", Path("missing/e.json")}}), kExitOutput);
  EXPECT_EQ(evaluate({{"output_path", folder_.Path()}}), kExitOutput);
  EXPECT_EQ(evaluate({{"ground_truth_format", "bal"}}), kExitUsage);
  // A pipe stays one: only regular files are replaced.
  ASSERT_EQ(RunShell("mkfifo " + Path("pipe")).exit_code, 0);
  RunShell("timeout 5 " + ShellQuoted(MFIR_COLMAP_EXE) +
           " multi_frame_evaluator --input_path " + Path("frames") +
           " --ground_truth_path " + Path("ground_truth") + " --output_path " +
           Path("pipe"));
  EXPECT_TRUE(fs::is_fifo(Path("pipe")));
}

TEST_F(BadOptionsTest, Simulator) {
  const auto simulate = [](const std::string& path,
                           const CommandOptions& options) {
    CommandOptions all = {{"output_path", path},
                          {"Simulator.num_points", "60"},
                          {"Simulator.num_cameras", "6"},
                          {"Simulator.num_frames", "1"},
                          {"Simulator.render_images", "0"}};
    for (const auto& [name, value] : options) all[name] = value;
    std::vector<std::string> arguments = {"multi_frame_simulator"};
    for (const auto& [name, value] : all) {
      arguments.insert(arguments.end(), {"--" + name, value});
    }
    return RunColmap(arguments).exit_code;
  };
  EXPECT_EQ(simulate(Path("new/a"), {}), kExitSuccess);
  EXPECT_EQ(simulate(folder_.Path(), {}), kExitOutput);
  EXPECT_EQ(simulate(Path("frames"), {{"Simulator.overwrite", "1"}}),
            kExitOutput);
  EXPECT_EQ(simulate(Path(std::string(300, 'x')), {}), kExitOutput);
  EXPECT_EQ(simulate(Path("KRT"), {}), kExitOutput);
  EXPECT_EQ(simulate(Path("b"), {{"Simulator.noise", "-1"}}), kExitUsage);
  EXPECT_EQ(simulate(Path("b"), {{"Simulator.nois", "1"}}), kExitUsage);
  EXPECT_EQ(simulate(Path("b"), {{"Simulator.num_threads", "0"}}), kExitUsage);
  const int code = simulate(Path("b"), {{"Simulator.num_threads", "100000"}});
  EXPECT_TRUE(code == kExitSuccess || code == kExitUsage) << code;
}

}  // namespace
}  // namespace mfir
