// The command multi_frame_evaluator on files.

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/io/work_folder.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class MultiFrameEvaluator : public testing::Test {
 protected:
  void SetUp() override {
    const testing::TestInfo* info =
        testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::path(testing::TempDir()) /
              (std::string("multi_frame_evaluator_") + info->name());
    fs::remove_all(folder_);
    WriteModel("truth", 0);
  }

  void TearDown() override { fs::remove_all(folder_); }

  std::string Path(const std::string& name) const {
    return (folder_ / name).string();
  }

  void WriteFile(const std::string& name, const std::string& text) const {
    fs::create_directories((folder_ / name).parent_path());
    std::ofstream(folder_ / name) << text;
  }

  // Cameras cam1 (fx = fy = 1000 + focal_error) and cam2 (fx = fy = 500).
  void WriteModel(const std::string& name,
                  double focal_error,
                  const std::string& size = "1000 500") const {
    const std::string focal = std::to_string(1000 + focal_error);
    WriteFile(name + "/cameras.txt",
              "1 PINHOLE " + size + " " + focal + " " + focal +
                  " 500 250\n"
                  "2 PINHOLE " +
                  size + " 500 500 500 250\n");
    WriteFile(name + "/images.txt",
              "1 1 0 0 0 0 0 0 1 cam1.png\n\n"
              "2 1 0 0 0 1 0 0 2 cam2.png\n\n");
    WriteFile(name + "/points3D.txt", "");
  }

  // Exit code of the command with the truth and a result file.
  int Run(const std::string& input,
          std::vector<std::string> arguments = {}) const {
    arguments.insert(arguments.begin(),
                     {"multi_frame_evaluator",
                      "--input_path",
                      Path(input),
                      "--ground_truth_path",
                      Path("truth"),
                      "--output_path",
                      Path("evaluation.json")});
    return RunPlain(arguments);
  }

  int RunPlain(std::vector<std::string> arguments) const {
    std::vector<char*> argv;
    for (std::string& argument : arguments) {
      argv.push_back(argument.data());
    }
    return RunMultiFrameEvaluator(static_cast<int>(argv.size()), argv.data());
  }

  nlohmann::json Result() const {
    std::ifstream file(folder_ / "evaluation.json");
    return nlohmann::json::parse(file);
  }

  fs::path folder_;
};

TEST_F(MultiFrameEvaluator, Model) {
  WriteModel("model", 3);
  ASSERT_EQ(Run("model"), kExitSuccess);
  const nlohmann::json result = Result();
  EXPECT_NEAR(result["focal_abs"]["mean"].get<double>(), 3, 1e-9);
  EXPECT_NEAR(result["focal_rel"]["mean"].get<double>(), 3, 1e-9);
  EXPECT_TRUE(result["focal_abs"]["max"].is_null());
  EXPECT_EQ(result["cameras"].size(), 2);
  EXPECT_EQ(result["cameras"][0]["name"], "cam1");
  EXPECT_FALSE(fs::exists(WorkFolder::Beside(Path("evaluation.json"))));
}

TEST_F(MultiFrameEvaluator, Result) {
  WriteModel("out/rig", 3);
  WriteModel("out/frames/000", 8);
  ASSERT_EQ(Run("out"), kExitSuccess);
  EXPECT_NEAR(Result()["focal_abs"]["mean"].get<double>(), 3, 1e-9);
  EXPECT_TRUE(Result()["focal_abs"]["min"].is_null());

  fs::remove_all(Path("out/frames"));
  WriteFile("out/summary.json", "{}");
  ASSERT_EQ(Run("out"), kExitSuccess);
  EXPECT_NEAR(Result()["focal_abs"]["mean"].get<double>(), 3, 1e-9);
}

TEST_F(MultiFrameEvaluator, Frames) {
  WriteModel("frames/000", 3);
  WriteModel("frames/015/sparse/0", -5);
  WriteFile("frames/notes/readme.txt", "no model");
  ASSERT_EQ(Run("frames"), kExitSuccess);
  nlohmann::json result = Result();
  EXPECT_EQ(result["num_frames"], 2);
  EXPECT_NEAR(result["focal_abs"]["mean"].get<double>(), 4, 1e-9);
  EXPECT_NEAR(result["focal_abs"]["max"].get<double>(), 5, 1e-9);
  EXPECT_NEAR(result["focal_abs"]["min"].get<double>(), 3, 1e-9);
  EXPECT_EQ(result["frames"][1]["name"], "015");

  WriteFile("list.txt", "015\n\n");
  ASSERT_EQ(Run("frames", {"--frame_list_path", Path("list.txt")}),
            kExitSuccess);
  result = Result();
  EXPECT_EQ(result["num_frames"], 1);
  EXPECT_NEAR(result["focal_abs"]["mean"].get<double>(), 5, 1e-9);
}

TEST_F(MultiFrameEvaluator, CameraNameRegex) {
  WriteModel("model", 3);
  WriteFile("model/images.txt",
            "1 1 0 0 0 0 0 0 1 shot7_cam1_a.png\n\n"
            "2 1 0 0 0 1 0 0 2 shot7_cam2_a.png\n\n"
            "3 1 0 0 0 1 0 0 1 shot7_cam1_b.png\n\n");
  EXPECT_EQ(Run("model"), kExitBadInput);
  const std::vector<std::string> regex = {"--MultiFrame.camera_name_regex",
                                          "(cam\\d+)"};
  ASSERT_EQ(Run("model", regex), kExitSuccess);
  EXPECT_EQ(Result()["num_cameras"], 2);

  // The third image now contradicts the first one.
  WriteFile("model/images.txt",
            "1 1 0 0 0 0 0 0 1 shot7_cam1_a.png\n\n"
            "3 1 0 0 0 1 0 0 2 shot7_cam1_b.png\n\n");
  EXPECT_EQ(Run("model", regex), kExitBadInput);
}

TEST_F(MultiFrameEvaluator, NamesOfAResultNeedNotMatchTheRegex) {
  WriteModel("truth", 0);
  WriteFile("truth/images.txt",
            "1 1 0 0 0 0 0 0 1 camera0001_frame5.png\n\n"
            "2 1 0 0 0 1 0 0 2 camera0002_frame5.png\n\n");
  WriteModel("out/rig", 3);
  WriteFile("out/rig/images.txt",
            "1 1 0 0 0 0 0 0 1 1\n\n"
            "2 1 0 0 0 1 0 0 2 0002\n\n");
  WriteFile("out/summary.json", "{}");
  ASSERT_EQ(
      Run("out", {"--MultiFrame.camera_name_regex", "camera(\\d+)_frame"}),
      kExitSuccess);
  EXPECT_EQ(Result()["num_cameras"], 2);
}

TEST_F(MultiFrameEvaluator, KrtTruthHasNoImageSize) {
  WriteModel("model", 3);
  WriteFile("truth.krt",
            "cam1\n1000 0 499\n0 1000 250\n0 0 1\n0 0 0 0 0\n"
            "1 0 0 0\n0 1 0 0\n0 0 1 0\n\n"
            "cam3\n1000 0 499\n0 1000 250\n0 0 1\n0 0 0 0 0\n"
            "1 0 0 1\n0 1 0 0\n0 0 1 0\n\n");
  const std::vector<std::string> arguments = {"multi_frame_evaluator",
                                              "--input_path",
                                              Path("model"),
                                              "--ground_truth_path",
                                              Path("truth.krt"),
                                              "--output_path",
                                              Path("evaluation.json")};
  ASSERT_EQ(RunPlain(arguments), kExitSuccess);
  nlohmann::json result = Result();
  EXPECT_EQ(result["num_cameras"], 1);
  EXPECT_EQ(result["missing_cameras"], nlohmann::json({"cam3"}));
  EXPECT_EQ(result["extra_cameras"], nlohmann::json({"cam2"}));
  EXPECT_NEAR(result["focal_abs"]["mean"].get<double>(), 6, 1e-9);
  EXPECT_NEAR(result["pp_abs"]["mean"].get<double>(), 1, 1e-9);
  EXPECT_NEAR(result["pp_rel"]["mean"].get<double>(), 1, 1e-9);

  std::vector<std::string> with_offset = arguments;
  with_offset.insert(
      with_offset.end(),
      {"--ground_truth_format", "krt", "--ground_truth_pixel_offset", "0.5"});
  ASSERT_EQ(RunPlain(with_offset), kExitSuccess);
  // Truth (499.5, 250.5), estimate (500, 250).
  EXPECT_NEAR(Result()["cameras"][0]["cx_error"].get<double>(), 0.5, 1e-9);
  EXPECT_NEAR(Result()["cameras"][0]["cy_error"].get<double>(), -0.5, 1e-9);
}

TEST_F(MultiFrameEvaluator, UsageErrors) {
  WriteModel("model", 3);
  EXPECT_EQ(RunPlain({"multi_frame_evaluator"}), kExitUsage);
  EXPECT_EQ(RunPlain({"multi_frame_evaluator", "--input_path", Path("model")}),
            kExitUsage);
  EXPECT_EQ(Run("model", {"--ground_truth_format", "matlab"}), kExitUsage);
  EXPECT_EQ(Run("model", {"--ground_truth_pixel_offset", "inf"}), kExitUsage);
  EXPECT_EQ(Run("model", {"--MultiFrame.camera_name_regex", "(a"}), kExitUsage);
  WriteFile("list.txt", "000\n");
  EXPECT_EQ(Run("model", {"--frame_list_path", Path("list.txt")}), kExitUsage);
  EXPECT_FALSE(fs::exists(Path("evaluation.json")));
}

TEST_F(MultiFrameEvaluator, BadInput) {
  EXPECT_EQ(Run("missing"), kExitBadInput);
  fs::create_directories(Path("empty"));
  EXPECT_EQ(Run("empty"), kExitBadInput);

  WriteModel("other_size", 3, "2000 1000");
  EXPECT_EQ(Run("other_size"), kExitBadInput);

  WriteModel("frames/000", 3);
  EXPECT_EQ(Run("frames", {"--frame_list_path", Path("no_list.txt")}),
            kExitBadInput);
  WriteFile("list.txt", "001\n");
  EXPECT_EQ(Run("frames", {"--frame_list_path", Path("list.txt")}),
            kExitBadInput);
  WriteFile("list.txt", "");
  EXPECT_EQ(Run("frames", {"--frame_list_path", Path("list.txt")}),
            kExitBadInput);

  WriteFile("frames/000/cameras.txt", "1 PINHOLE 1000 500 nonsense\n");
  EXPECT_EQ(Run("frames"), kExitBadInput);
  fs::remove_all(Path("truth"));
  WriteModel("frames/000", 3);
  EXPECT_EQ(Run("frames"), kExitBadInput);
  EXPECT_FALSE(fs::exists(Path("evaluation.json")));
}

TEST_F(MultiFrameEvaluator, UnwritableOutput) {
  WriteModel("model", 3);
  const auto run_with_output = [this](const std::string& output_path) {
    return RunPlain({"multi_frame_evaluator",
                     "--input_path",
                     Path("model"),
                     "--ground_truth_path",
                     Path("truth"),
                     "--output_path",
                     output_path});
  };
  EXPECT_EQ(run_with_output(Path("no_folder/evaluation.json")), kExitOutput);
  // A folder of this name exists.
  EXPECT_EQ(run_with_output(Path("truth")), kExitOutput);
  EXPECT_FALSE(fs::exists(WorkFolder::Beside(Path("truth"))));
  EXPECT_TRUE(fs::exists(Path("truth/cameras.txt")));
}

// Only an earlier evaluation is.
TEST_F(MultiFrameEvaluator, OtherFilesAreNotReplaced) {
  WriteModel("model", 3);
  WriteFile("summary.json", "{\"evaluation\": {\"focal_abs\": 1}}");
  for (const std::string name : {"truth/cameras.txt", "summary.json"}) {
    const auto size = fs::file_size(Path(name));
    EXPECT_EQ(RunPlain({"multi_frame_evaluator",
                        "--input_path",
                        Path("model"),
                        "--ground_truth_path",
                        Path("truth"),
                        "--output_path",
                        Path(name)}),
              kExitOutput);
    EXPECT_EQ(fs::file_size(Path(name)), size);
  }
  EXPECT_EQ(Run("model"), kExitSuccess);
  EXPECT_EQ(Run("model"), kExitSuccess);
}

}  // namespace
}  // namespace mfir
