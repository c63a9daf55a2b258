// What the refiner does with extrinsics that are not those of the frames.

#include <random>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/geometry/pose_conventions.h"
#include "tests/support/pose_files.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

using WrongRigTest = RefinerTest;

TEST_F(WrongRigTest, RigOfAnotherArray) {
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  ChangeRig([&](host::Reconstruction* rig) {
    for (const auto& [id, image] : rig->Images()) {
      const Eigen::Vector4d qvec(
          normal(random), normal(random), normal(random), normal(random));
      const Eigen::Vector3d translation(
          normal(random), normal(random), normal(random));
      SetPose(id, qvec.normalized(), translation, rig);
    }
  });
  ExpectError(kExitBadInput, {"known extrinsics", "RIG of this array"});
  ChangeRig([&](host::Reconstruction* rig) {
    RenameImages([](const std::string& name) { return "other_" + name; }, rig);
  });
  ExpectError(kExitBadInput,
              {"cam00.png", "other_cam00", "RIG", "camera_name_regex"});
}

// With formula, in each format.
TEST_F(WrongRigTest, RigInAnotherConvention) {
  const Rig rig = ReadRig(Path("rig"), "colmap", CameraNaming(), std::nan(""));
  for (const PoseConvention& convention : OtherPoseConventions()) {
    SCOPED_TRACE(convention.Description());
    std::map<std::string, Rigid3> poses;
    std::vector<KnownCamera> cameras = rig.cameras;
    for (KnownCamera& camera : cameras) {
      camera.cam_from_world = InConvention(convention, camera.cam_from_world);
      poses[camera.image_name] = camera.cam_from_world;
    }
    WriteKRT(Path("other.krt"), cameras);
    ChangeRig([&](host::Reconstruction* model) {
      for (const auto& [id, image] : model->Images()) {
        host::SetCamFromWorld(poses.at(image.Name()), &model->Image(id));
      }
    });
    for (const std::string& path : {Path("rig"), Path("other.krt")}) {
      ExpectError(kExitBadInput,
                  {"fit 3 of 3 frames in another convention of poses only: ",
                   "RIG seems to hold " + convention.Description() + ".",
                   convention.Formula()},
                  {{"extrinsics_path", path}});
    }
  }
}

// The mirror image of a nearly planar array passes the alignment of frames.
TEST_F(WrongRigTest, MirroredRigOfANearlyPlanarArray) {
  SimulatorOptions options = SmallCapture();
  options.min_elevation = -10.0;
  options.max_elevation = 10.0;
  WriteSimulatedCapture(SimulateCapture(options), Path("flat"));
  const CommandOptions inputs = {{"input_path", Path("flat/frames")},
                                 {"extrinsics_path", Path("other.krt")}};
  Rig rig = ReadRig(Path("flat/rig"), "colmap", CameraNaming(), std::nan(""));
  WriteKRT(Path("other.krt"), rig.cameras);
  ExpectRefines(inputs);
  const PoseConvention mirrored = {false, {1, -1, 1}};
  for (KnownCamera& camera : rig.cameras) {
    camera.cam_from_world = InConvention(mirrored, camera.cam_from_world);
  }
  WriteKRT(Path("other.krt"), rig.cameras);
  ExpectError(kExitBadInput, {"mirrored", mirrored.Formula()}, inputs);
  // A matrix that is no rotation says it by itself.
  WriteFile(Path("other.krt"),
            "cam00\n500 0 320\n0 500 240\n0 0 1\n0 0 0 0 0\n1 0 0 0\n0 1 0 "
            "0\n0 0 -1 0\n");
  ExpectError(kExitBadInput, {"mirrored", "third column"}, inputs);
}

// The right poses under wrong names: whatever aligns, it is not the rig of this
// array, and must not be reported as a success.
TEST_F(WrongRigTest, RigWithExchangedNames) {
  ChangeRig([](host::Reconstruction* rig) {
    rig->Image(1).SetName("x");
    for (int i = 2; i <= 8; ++i) {
      rig->Image(i).SetName("cam0" + std::to_string(i - 2) + ".png");
    }
    rig->Image(1).SetName("cam07.png");
  });
  EXPECT_NE(Refine().exit_code, kExitSuccess);
}

// One or two wrong cameras: the result says which.
TEST_F(WrongRigTest, CamerasThatContradictTheRigAreFlagged) {
  const auto expect_flags = [this](const std::vector<std::string>& names) {
    const CommandResult result = Refine({{"MultiFrame.quiet", "1"}});
    EXPECT_TRUE(result.exit_code == kExitSuccess ||
                result.exit_code == kExitSolver)
        << result.error;
    std::vector<std::string> flagged;
    const nlohmann::json summary = Summary();
    for (const nlohmann::json& camera : summary["cameras"]) {
      for (const nlohmann::json& flag : camera["flags"]) {
        if (flag == "contradicts_extrinsics") flagged.push_back(camera["name"]);
      }
    }
    EXPECT_EQ(flagged, names);
    for (const std::string& name : names) {
      EXPECT_NE(result.error.find("WARNING: camera '" + name + "'"),
                std::string::npos)
          << result.error;
    }
    fs::remove_all(Path("out"));
  };
  expect_flags({});
  ChangeRig([](host::Reconstruction* rig) {
    const std::string name = rig->Image(2).Name();
    rig->Image(2).SetName(rig->Image(6).Name());
    rig->Image(6).SetName(name);
  });
  expect_flags({"cam01", "cam05"});
  fs::remove_all(Path("rig"));
  fs::copy(*original_ / "capture/rig", Path("rig"));
  ChangeRig([](host::Reconstruction* rig) {
    SetTranslation(4, Eigen::Vector3d(1e6, 0, 0), rig);
  });
  expect_flags({"cam03"});
}

// In a small array wrong cameras may spoil all others, also where the solve
// converges: neither a success, nor a reason to replace an earlier result.
TEST_F(WrongRigTest, WrongCamerasThatSpoilAllOthersAreAnError) {
  ExpectRefines();
  const std::string good_summary = ReadFile(Path("out/summary.json"));
  ChangeRig([](host::Reconstruction* rig) {
    const std::string name = rig->Image(2).Name();
    rig->Image(2).SetName(rig->Image(6).Name());
    rig->Image(6).SetName(name);
  });
  ExpectError(kExitSolver,
              {"WARNING: camera 'cam01'",
               "ERROR: Cameras that contradict their extrinsics in RIG "
               "('cam01', 'cam05')",
               "Correct these cameras in RIG, or remove them from it"},
              {},
              "WARNING");
  EXPECT_EQ(ReadFile(Path("out/summary.json")), good_summary);
  EXPECT_EQ(Summary("out/not_converged")["result"]["status"],
            "contradicting_extrinsics");
  // Without them in RIG all is well.
  ChangeRig([](host::Reconstruction* rig) {
    rig->Image(2).SetName("none1");
    rig->Image(6).SetName("none2");
  });
  ExpectRefines();
}

}  // namespace
}  // namespace mfir
