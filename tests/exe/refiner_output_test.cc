// What the refiner writes.

#include <algorithm>

#include "colmap_ext/host/rig_model.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

using RefinerOutputTest = RefinerReferenceTest;

TEST_F(RefinerOutputTest, AllFilesOfTheResult) {
  std::vector<std::string> names;
  for (const auto& name_and_file : Files("reference")) {
    names.push_back(name_and_file.first);
    const bool may_be_empty =
        name_and_file.first.find("points3D") != std::string::npos;
    EXPECT_TRUE(may_be_empty || !name_and_file.second.empty());
  }
  std::vector<std::string> expected = {
      "KRT", "history.csv", "project.ini", "report.html", "summary.json"};
  std::vector<std::string> parts = {"cameras", "images", "points3D"};
  if (host::kHasRigs) parts.insert(parts.end(), {"frames", "rigs"});
  for (const std::string& part : parts) {
    for (const std::string model : {"frames/frame000000",
                                    "frames/frame000001",
                                    "frames/frame000002",
                                    "model",
                                    "rig"}) {
      expected.push_back(model + "/" + part + ".bin");
    }
    expected.push_back("rig/" + part + ".txt");
  }
  std::sort(expected.begin(), expected.end());
  EXPECT_EQ(names, expected);
}

TEST_F(RefinerOutputTest, SummaryHasTheKeysOfTheContract) {
  ExpectRefines({{"ground_truth_path", Path("ground_truth")}});
  const nlohmann::json summary = Summary();
  const auto expect_keys = [](const nlohmann::json& object,
                              const std::vector<std::string>& keys) {
    for (const std::string& key : keys) {
      EXPECT_TRUE(object.contains(key)) << key << " is not in " << object;
    }
  };
  EXPECT_EQ(summary["schema_version"], 1);
  expect_keys(summary,
              {"tool",
               "options",
               "inputs",
               "frames",
               "cameras",
               "stages",
               "result",
               "timings_s",
               "peak_rss_bytes",
               "evaluation",
               "created"});
  expect_keys(summary["inputs"], {"files"});
  EXPECT_GE(summary["inputs"]["files"].size(), 3 + 2 + 3 * 3);
  for (const nlohmann::json& file : summary["inputs"]["files"]) {
    EXPECT_EQ(file["bytes"], fs::file_size(file["path"].get<std::string>()));
    EXPECT_EQ(file["sha256"].get<std::string>().size(), 64);
  }
  expect_keys(summary["tool"], {"version", "colmap_version", "git"});
  for (const nlohmann::json& frame : summary["frames"]) {
    expect_keys(frame,
                {"name",
                 "status",
                 "reason",
                 "num_images",
                 "num_points",
                 "num_observations",
                 "alignment_rms"});
  }
  for (const nlohmann::json& camera : summary["cameras"]) {
    expect_keys(camera,
                {"name",
                 "model",
                 "width",
                 "height",
                 "params",
                 "params_initial",
                 "params_std",
                 "num_frames",
                 "num_observations",
                 "rms_px_before",
                 "rms_px_after",
                 "flags"});
    EXPECT_EQ(camera["params_std"].size(), 4);
    EXPECT_GT(camera["rms_px_before"], camera["rms_px_after"]);
  }
  for (const nlohmann::json& stage : summary["stages"]) {
    expect_keys(
        stage,
        {"index", "weights", "iterations", "time_s", "cost", "termination"});
    expect_keys(stage["cost"], {"reprojection"});
  }
  expect_keys(summary["result"],
              {"status", "rms_px_before", "rms_px_after", "held_out_rms_px"});
  EXPECT_EQ(summary["result"]["status"], "converged");
  expect_keys(summary["result"]["static_points"],
              {"num_points", "num_tracks", "observation_share"});
  EXPECT_GT(summary["peak_rss_bytes"], 1000000);
  expect_keys(summary["evaluation"],
              {"focal_abs", "focal_rel", "pp_abs", "pp_rel"});
  EXPECT_FALSE(Summary("reference").contains("evaluation"));
  // history.csv: a header, and a row per stage.
  const std::string history = ReadFile(Path("out/history.csv"));
  EXPECT_EQ(std::count(history.begin(), history.end(), '\n'),
            1 + summary["stages"].size());
}

TEST_F(RefinerOutputTest, ProjectFileReproducesTheResult) {
  const CommandOptions options = {{"MultiFrame.loss_scale", "0.7"},
                                  {"MultiFrame.camera_model", "SIMPLE_RADIAL"},
                                  {"ground_truth_path", Path("ground_truth")}};
  ExpectRefines(options);
  const auto rig = Files("out/rig");
  const std::string project = ReadFile(Path("out/project.ini"));
  fs::copy(Path("out/project.ini"), Path("project.ini"));
  fs::remove_all(Path("out"));
  const CommandResult again = RunColmap({"multi_frame_intrinsics_refiner",
                                         "--project_path",
                                         Path("project.ini")});
  ASSERT_EQ(again.exit_code, kExitSuccess) << again.error;
  EXPECT_TRUE(rig == Files("out/rig"));
  EXPECT_EQ(project, ReadFile(Path("out/project.ini")));
  // The command line wins.
  const CommandResult other = RunColmap({"multi_frame_intrinsics_refiner",
                                         "--project_path",
                                         Path("project.ini"),
                                         "--output_path",
                                         Path("other"),
                                         "--MultiFrame.camera_model",
                                         "PINHOLE"});
  ASSERT_EQ(other.exit_code, kExitSuccess) << other.error;
  EXPECT_EQ(Summary("other")["cameras"][0]["model"], "PINHOLE");
  EXPECT_EQ(Summary("other")["options"]["MultiFrame.loss_scale"], 0.7);
}

TEST_F(RefinerOutputTest, ProjectFileHoldsUnusualPaths) {
  for (const std::string name : {"fr #1", "fr'\"=[x]"}) {
    fs::rename(Path("frames"), Path(name));
    ExpectRefines({{"input_path", Path(name)}});
    const auto rig = Files("out/rig");
    fs::copy(Path("out/project.ini"),
             Path("project.ini"),
             fs::copy_options::overwrite_existing);
    const CommandResult again = RunColmap({"multi_frame_intrinsics_refiner",
                                           "--project_path",
                                           Path("project.ini")});
    EXPECT_EQ(again.exit_code, kExitSuccess) << again.error;
    EXPECT_TRUE(rig == Files("out/rig"));
    fs::rename(Path(name), Path("frames"));
  }
}

TEST_F(RefinerOutputTest, ForeignSectionsOfAProjectFileAreSkipped) {
  WriteFile(Path("project.ini"),
            "database_path=x.db\n[SiftExtraction]\nuse_gpu=1\n[MultiFrame]\n"
            "camera_model=SIMPLE_PINHOLE\n[Mapper]\nmin_num_matches=15\n");
  ExpectRefines({{"project_path", Path("project.ini")}});
  EXPECT_EQ(Summary()["cameras"][0]["model"], "SIMPLE_PINHOLE");
}

// "Fixed" means the same doubles, whenever COLMAP's normalization of
// quaternions leaves the known ones as they are; where it changes their last
// bits at each reading, the result has a neighbour that it does not change.
TEST_F(RefinerOutputTest, ExtrinsicsAreBitIdentical) {
  host::Reconstruction rig = Read(Path("rig"));
  for (int i = 0; i < 6; ++i) {
    Similarity3 rotated;
    rotated.rotation =
        Eigen::Quaterniond(0.3 + i, -0.5, 0.7 * i, 0.4).normalized();
    host::TransformReconstruction(rotated, &rig);
    fs::remove_all(Path("rig"));
    i % 2 == 0 ? WriteText(rig, Path("rig")) : WriteBinary(rig, Path("rig"));
    const host::Reconstruction known = Read(Path("rig"));
    ExpectRefines();
    for (const std::string name :
         {"rig", "frames/frame000000", "frames/frame000002"}) {
      const host::Reconstruction result = Read(Path("out/" + name));
      ASSERT_EQ(result.NumRegImages(), 8);
      for (const host::image_t id : result.RegImageIds()) {
        const host::Image* image =
            known.FindImageWithName(result.Image(id).Name());
        ASSERT_NE(image, nullptr);
        const Rigid3 pose = host::CamFromWorld(result.Image(id));
        const Rigid3 known_pose = host::CamFromWorld(*image);
        const auto& q = pose.rotation.coeffs();
        const auto& known_q = known_pose.rotation.coeffs();
        EXPECT_EQ(host::StableQuaternion(pose.rotation).coeffs(), q);
        EXPECT_EQ(host::StableQuaternion(known_pose.rotation).coeffs(), q);
        EXPECT_LT((q - known_q).norm(), 4.5e-16);
        EXPECT_EQ(pose.translation, known_pose.translation);
      }
    }
  }
}

TEST_F(RefinerOutputTest, KRTKeepsTheMatricesOfKRT) {
  ExpectRefines({{"extrinsics_path", Path("KRT")}});
  const Rig known = ReadRig(Path("KRT"), "krt", CameraNaming(), NAN);
  const Rig refined = ReadRig(Path("out/KRT"), "krt", CameraNaming(), NAN);
  ASSERT_EQ(refined.cameras.size(), known.cameras.size());
  for (size_t i = 0; i < known.cameras.size(); ++i) {
    EXPECT_EQ(refined.cameras[i].name, known.cameras[i].name);
    EXPECT_EQ(*refined.cameras[i].matrix, *known.cameras[i].matrix);
    const std::vector<double> params = Params().at(known.cameras[i].name);
    EXPECT_EQ(refined.cameras[i].params, params);
  }
}

TEST_F(RefinerOutputTest, FramesCarryTheGlobalIntrinsics) {
  for (const char* frame : kFrames) {
    const host::Reconstruction result =
        Read(Path(std::string("reference/frames/") + frame));
    const host::Reconstruction input = Read(ModelPath(frame));
    EXPECT_EQ(result.NumPoints3D(), input.NumPoints3D());
    EXPECT_EQ(result.ComputeNumObservations(), input.ComputeNumObservations());
    for (const auto& [id, image] : result.Images()) {
      EXPECT_EQ(host::Params(result.Camera(image.CameraId())),
                reference_.at(image.Name().substr(0, 5)));
    }
    // In the rig's coordinates: near the truth.
    const host::Reconstruction truth =
        Read(Path(std::string("ground_truth_frames/") + frame));
    std::vector<double> errors;
    for (const auto& [id, point] : result.Points3D()) {
      errors.push_back(
          (host::Xyz(point) - host::Xyz(truth.Point3D(id))).norm());
    }
    EXPECT_LT(host::Median(errors), 0.01);
  }
}

TEST_F(RefinerOutputTest, ResultIsInputAgain) {
  // Of the evaluator.
  const CommandResult evaluation = RunColmap({"multi_frame_evaluator",
                                              "--input_path",
                                              Path("reference"),
                                              "--ground_truth_path",
                                              Path("ground_truth"),
                                              "--output_path",
                                              Path("evaluation.json")});
  EXPECT_EQ(evaluation.exit_code, kExitSuccess) << evaluation.error;
  ExpectRefines({{"ground_truth_path", Path("ground_truth")}});
  const nlohmann::json evaluated =
      nlohmann::json::parse(ReadFile(Path("evaluation.json")));
  EXPECT_EQ(evaluated["focal_abs"], Summary()["evaluation"]["focal_abs"]);
  // Of a second run, where nothing is left to do.
  for (const std::string rig : {"rig", "KRT"}) {
    ExpectRefines({{"input_path", Path("reference/frames")},
                   {"extrinsics_path", Path("reference/" + rig)}});
    EXPECT_LT(MaxRelativeDifference(reference_, Params()), 2e-3);
  }
}

}  // namespace
}  // namespace mfir
