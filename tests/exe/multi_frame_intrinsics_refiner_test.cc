// The refiner from end to end: every kind of input.

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class MultiFrameRefinerTest : public RefinerReferenceTest {
 protected:
  // Expects the result of the capture as it was made.
  void ExpectSameResult(const CommandOptions& options = {}) const {
    ExpectRefines(options);
    EXPECT_LT(MaxRelativeDifference(reference_, Params()), 1e-9)
        << testing::PrintToString(options);
  }

  // Moves the model of a frame to FRAME/`folder`.
  void MoveModel(const std::string& frame, const std::string& folder) const {
    fs::rename(ModelPath(frame), Path("model"));
    fs::remove_all(Path("frames/" + frame));
    fs::create_directories(
        fs::path(Path("frames/" + frame + "/" + folder + "x")).parent_path());
    if (folder.empty()) fs::remove_all(Path("frames/" + frame));
    fs::rename(Path("model"), Path("frames/" + frame + "/" + folder));
  }

  void WriteOpenCVRig(double shift) const {
    const Rig rig = ReadRig(Path("rig"), "colmap", CameraNaming(), NAN);
    std::ostringstream intri, extri;
    intri.precision(17);
    extri.precision(17);
    const auto matrix = [](std::ostream& stream,
                           const std::string& name,
                           int rows,
                           int cols,
                           const std::vector<double>& values) {
      stream << name << ": !!opencv-matrix\n   rows: " << rows
             << "\n   cols: " << cols << "\n   dt: d\n   data: [";
      for (size_t i = 0; i < values.size(); ++i) {
        stream << (i == 0 ? "" : ", ") << values[i];
      }
      stream << "]\n";
    };
    intri << "%YAML:1.0\n---\nnames:\n";
    extri << "%YAML:1.0\n---\nnames:\n";
    for (const KnownCamera& camera : rig.cameras) {
      intri << "   - \"" << camera.name << "\"\n";
      extri << "   - \"" << camera.name << "\"\n";
    }
    for (const KnownCamera& camera : rig.cameras) {
      const auto& p = camera.params;
      matrix(intri,
             "K_" + camera.name,
             3,
             3,
             {p[0], 0, p[2] + shift, 0, p[1], p[3] + shift, 0, 0, 1});
      matrix(intri, "dist_" + camera.name, 5, 1, {0, 0, 0, 0, 0});
      const Eigen::Matrix3d R =
          camera.cam_from_world.rotation.toRotationMatrix();
      const Eigen::Vector3d& t = camera.cam_from_world.translation;
      matrix(extri,
             "Rot_" + camera.name,
             3,
             3,
             {R(0, 0),
              R(0, 1),
              R(0, 2),
              R(1, 0),
              R(1, 1),
              R(1, 2),
              R(2, 0),
              R(2, 1),
              R(2, 2)});
      matrix(extri, "T_" + camera.name, 3, 1, {t(0), t(1), t(2)});
    }
    WriteFile(Path("opencv/intri.yml"), intri.str());
    WriteFile(Path("opencv/extri.yml"), extri.str());
  }
};

TEST_F(MultiFrameRefinerTest, TextAndBinaryModels) {
  for (const char* frame : kFrames) {
    const host::Reconstruction model = Read(ModelPath(frame));
    fs::remove_all(ModelPath(frame));
    WriteText(model, ModelPath(frame));
  }
  ExpectSameResult();
  const host::Reconstruction rig = Read(Path("rig"));
  fs::remove_all(Path("rig"));
  WriteBinary(rig, Path("rig"));
  ExpectSameResult();
  fs::remove(Path("rig/points3D.bin"));
  ExpectSameResult();
}

TEST_F(MultiFrameRefinerTest, FolderVariants) {
  MoveModel("frame000000", "");
  MoveModel("frame000001", "0/");
  MoveModel("frame000002", "sparse/");
  ExpectSameResult();
  fs::rename(Path("frames/frame000002/sparse"),
             Path("frames/frame000002/refined"));
  ExpectSameResult();
}

TEST_F(MultiFrameRefinerTest, ModelWithMostRegisteredImagesWins) {
  for (const char* folder : {"sparse/1", "", "0", "sparse", "refined"}) {
    host::Reconstruction part = Read(ModelPath("frame000001"));
    KeepImages(5, &part);
    WriteBinary(part, Path(std::string("frames/frame000001/") + folder));
  }
  ExpectSameResult();
  fs::rename(Path("frames/frame000001/sparse/0"), Path("complete"));
  fs::rename(Path("frames/frame000001/sparse/1"),
             Path("frames/frame000001/sparse/0"));
  fs::rename(Path("complete"), Path("frames/frame000001/sparse/1"));
  ExpectSameResult();
}

TEST_F(MultiFrameRefinerTest, RigFormatsGiveTheSameResult) {
  const auto expect_same = [this](const CommandOptions& options) {
    ExpectRefines(options);
    // KRT and OpenCV hold the rotation with the rounding of a matrix.
    EXPECT_LT(MaxRelativeDifference(reference_, Params()), 1e-8)
        << testing::PrintToString(options);
  };
  WriteOpenCVRig(-0.5);
  expect_same({{"extrinsics_path", Path("KRT")}});
  EXPECT_EQ(Summary()["inputs"]["extrinsics_format"], "krt");
  expect_same({{"extrinsics_path", Path("KRT")}, {"extrinsics_format", "krt"}});
  expect_same({{"extrinsics_path", Path("opencv")}});
  EXPECT_EQ(Summary()["inputs"]["extrinsics_format"], "opencv");
  expect_same(
      {{"extrinsics_path", Path("opencv")}, {"extrinsics_format", "opencv"}});
  // The intrinsics of RIG are not used.
  expect_same({{"extrinsics_path", Path("opencv")},
               {"extrinsics_pixel_offset", "100"}});
  fs::remove(Path("opencv/intri.yml"));
  expect_same({{"extrinsics_path", Path("opencv")}});
}

TEST_F(MultiFrameRefinerTest, PixelOffsetOfTheRigFormats) {
  WriteOpenCVRig(0.0);
  const auto initial_cx = [this](CommandOptions options) {
    options["MultiFrame.use_prior_intrinsics"] = "1";
    ExpectRefines(options);
    return Params("out", "params_initial").at("cam03")[2];
  };
  const double cx = host::Params(Read(Path("rig")).Camera(4))[2];
  EXPECT_NEAR(initial_cx({}), cx, 1e-9);
  EXPECT_NEAR(initial_cx({{"extrinsics_path", Path("KRT")}}), cx, 1e-9);
  EXPECT_NEAR(
      initial_cx({{"extrinsics_path", Path("opencv")}}), cx + 0.5, 1e-9);
  EXPECT_NEAR(initial_cx({{"extrinsics_path", Path("opencv")},
                          {"extrinsics_pixel_offset", "0"}}),
              cx,
              1e-9);
  EXPECT_NEAR(initial_cx({{"extrinsics_path", Path("KRT")},
                          {"extrinsics_pixel_offset", "0.25"}}),
              cx + 0.25,
              1e-9);
}

TEST_F(MultiFrameRefinerTest, CameraNames) {
  const auto rename = [this](const std::function<std::string(int)>& in_frames,
                             const std::function<std::string(int)>& in_rig) {
    const auto new_name = [](const auto& f) {
      return [f](const std::string& name) {
        // The number behind "cam", or the first one of an earlier renaming.
        return f(std::stoi(name.substr(name.find_first_of("0123456789"))));
      };
    };
    ChangeFrames([&](host::Reconstruction* model) {
      RenameImages(new_name(in_frames), model);
    });
    host::Reconstruction rig = Read(Path("rig"));
    RenameImages(new_name(in_rig), &rig);
    WriteText(rig, Path("rig"));
  };
  const auto expect_same = [this](const CommandOptions& options = {}) {
    ExpectRefines(options);
    CameraParams params;
    for (const auto& [name, values] : Params()) {
      const std::string number = name.substr(name.find_first_of("0123456789"));
      params["cam0" + std::to_string(std::stoi(number))] = values;
    }
    EXPECT_LT(MaxRelativeDifference(reference_, params), 1e-9);
  };
  const auto text = [](int i) { return std::to_string(i); };

  rename([&](int i) { return "camera" + text(i) + "_frame17.jpg"; },
         [&](int i) { return "camera" + text(i) + "_frame1.png"; });
  expect_same();
  EXPECT_EQ(Summary()["cameras"][3]["name"], "3");
  rename([&](int i) { return text(i) + "/image.jpg"; },
         [&](int i) { return "00" + text(i) + ".png"; });
  expect_same();
  rename([&](int i) { return "0000" + text(i) + ".png"; },
         [&](int i) { return text(i); });
  expect_same();
  rename([&](int i) { return "x" + text(i) + "y_take2.png"; },
         [&](int i) { return "a/x" + text(i) + "y.png"; });
  EXPECT_EQ(Refine().exit_code, kExitBadInput);
  expect_same({{"MultiFrame.camera_name_regex", "(x\\d+y)"}});
}

TEST_F(MultiFrameRefinerTest, ImageNamesWithSpacesAreKept) {
  const auto new_name = [](const std::string& name) { return "my " + name; };
  ChangeFrames(
      [&](host::Reconstruction* model) { RenameImages(new_name, model); });
  host::Reconstruction rig = Read(Path("rig"));
  RenameImages(new_name, &rig);
  fs::remove_all(Path("rig"));
  WriteBinary(rig, Path("rig"));
  ExpectRefines();
  EXPECT_EQ(Read(Path("out/rig")).Image(1).Name(), "my cam00.png");
}

TEST_F(MultiFrameRefinerTest, MissingUnregisteredAndUnknownCameras) {
  // cam07 not registered in frame 0; cam06 nowhere; cam05 not in RIG.
  ChangeFrame("frame000000", [](host::Reconstruction* model) {
    host::DeRegisterImage(8, model);
    model->TearDown();
  });
  ChangeFrames([](host::Reconstruction* model) {
    host::DeRegisterImage(7, model);
    model->TearDown();
  });
  host::Reconstruction rig = Read(Path("rig"));
  host::DeRegisterImage(6, &rig);
  rig.TearDown();
  WriteText(rig, Path("rig"));
  ExpectRefines();
  const nlohmann::json summary = Summary();
  EXPECT_EQ(summary["inputs"]["num_rig_cameras"], 7);
  EXPECT_EQ(summary["inputs"]["cameras_without_images"],
            nlohmann::json({"cam06"}));
  EXPECT_EQ(summary["inputs"]["images_without_camera"],
            nlohmann::json({"frame000000/cam05.png",
                            "frame000001/cam05.png",
                            "frame000002/cam05.png"}));
  EXPECT_EQ(summary["cameras"].size(), 6);
  EXPECT_EQ(summary["cameras"][5]["name"], "cam07");
  EXPECT_EQ(summary["cameras"][5]["num_frames"], 2);
  EXPECT_EQ(summary["frames"][0]["num_images"], 5);
  EXPECT_EQ(Read(Path("out/rig")).NumRegImages(), 6);
  EXPECT_EQ(Read(Path("out/frames/frame000001")).NumRegImages(), 6);
  // They also stand in the log.
  EXPECT_NE(Refine().output.find("'cam06' of the rig has no image"),
            std::string::npos);
}

// As a wrong name of a camera looks: to be seen also where nothing is printed.
TEST_F(MultiFrameRefinerTest, NearestNamesOfCamerasWithoutImages) {
  ChangeRig(
      [](host::Reconstruction* rig) { rig->Image(6).SetName("CAM5.png"); });
  const CommandResult result = Refine({{"MultiFrame.quiet", "1"}});
  EXPECT_EQ(result.exit_code, kExitSuccess);
  EXPECT_NE(result.error.find(
                "WARNING: camera 'CAM5' of RIG has no image; nearest among the "
                "images without camera: 'frame000000/cam05.png', camera "
                "'cam05'"),
            std::string::npos)
      << result.error;
  // A camera of RIG without images alone is no warning.
  ChangeFrames([](host::Reconstruction* model) {
    host::DeRegisterImage(6, model);
    model->TearDown();
  });
  EXPECT_EQ(Refine({{"MultiFrame.quiet", "1"}}).error, "");
}

// An image without points, or even without keypoints (an empty line in the
// text format), must not take the later ones with it.
TEST_F(MultiFrameRefinerTest, ImagesWithoutPoints) {
  for (const char* frame : kFrames) {
    host::Reconstruction model = Read(ModelPath(frame));
    for (host::point2D_t i = 0; i < model.Image(2).NumPoints2D(); ++i) {
      if (model.Image(2).Point2D(i).HasPoint3D()) {
        model.DeleteObservation(2, i);
      }
    }
    fs::remove_all(ModelPath(frame));
    WriteText(model, ModelPath(frame));
    const std::string path = ModelPath(frame) + "/images.txt";
    std::string text = ReadFile(path);
    const size_t begin = text.find("cam01.png\n") + 10;
    if (frame != std::string(kFrames[0])) {
      text.erase(begin, text.find('\n', begin) - begin);
    }
    WriteFile(path, text);
  }
  ExpectRefines();
  const nlohmann::json summary = Summary();
  ASSERT_EQ(summary["cameras"].size(), 8);
  for (size_t i = 0; i < 8; ++i) {
    const bool empty = i == 1;
    EXPECT_EQ(summary["cameras"][i]["num_observations"] == 0, empty) << i;
    EXPECT_EQ(summary["cameras"][i]["rms_px_after"].is_null(), empty);
    const bool same = summary["cameras"][i]["params"] ==
                      summary["cameras"][i]["params_initial"];
    EXPECT_EQ(same, empty) << i;
  }
  EXPECT_EQ(summary["cameras"][1]["flags"][0], "no_observations");
}

TEST_F(MultiFrameRefinerTest, WeakFramesAreSkippedWithAReason) {
  const auto expect_skipped = [this](const std::string& frame,
                                     const std::string& reason) {
    ExpectRefines();
    const nlohmann::json summary = Summary();
    for (const nlohmann::json& json : summary["frames"]) {
      const bool skipped = json["name"] == frame;
      EXPECT_EQ(json["status"], skipped ? "skipped" : "used") << json;
      EXPECT_EQ(
          json["reason"].get<std::string>().find(reason) != std::string::npos,
          skipped)
          << json;
      EXPECT_EQ(
          fs::exists(Path("out/frames/" + json["name"].get<std::string>())),
          !skipped);
    }
  };
  for (const char* frame : kFrames) {
    SCOPED_TRACE(frame);
    const host::Reconstruction model = Read(ModelPath(frame));
    ChangeFrame(frame, [](host::Reconstruction* m) { KeepImages(2, m); });
    expect_skipped(frame, "only 2 of its images");
    WriteBinary(model, ModelPath(frame));
    ChangeFrame(frame, [](host::Reconstruction* m) { RemovePoints(m); });
    expect_skipped(frame, "no points");
    fs::remove_all(ModelPath(frame));
    expect_skipped(frame, "no sparse model");
    WriteBinary(model, ModelPath(frame));
    ChangeFrame(frame, [](host::Reconstruction* m) {
      for (int i = 1; i <= 8; ++i) {
        const Eigen::Vector4d qvec = Eigen::Vector4d::Random().normalized();
        SetPose(i, qvec, Eigen::Vector3d::Random(), m);
      }
    });
    expect_skipped(frame, "camera poses fit");
    WriteBinary(model, ModelPath(frame));
  }
}

TEST_F(MultiFrameRefinerTest, FrameList) {
  WriteFile(Path("list"),
            WithInvisibles("frame000002\n# chosen\n\n frame000000\n"));
  ExpectRefines({{"frame_list_path", Path("list")}});
  const nlohmann::json summary = Summary();
  ASSERT_EQ(summary["frames"].size(), 2);
  EXPECT_EQ(summary["frames"][0]["name"], "frame000000");
  EXPECT_EQ(summary["frames"][1]["name"], "frame000002");
  const CameraParams listed = Params();
  fs::remove_all(Path("frames/frame000001"));
  ExpectRefines();
  EXPECT_EQ(MaxRelativeDifference(listed, Params()), 0.0);
}

TEST_F(MultiFrameRefinerTest, ConstantCameraListWithInvisibleCharacters) {
  WriteFile(Path("list"), WithInvisibles("cam02\ncam05\n"));
  ExpectRefines({{"constant_camera_list_path", Path("list")}});
  const CameraParams start = Params("out", "params_initial");
  for (const auto& [name, params] : Params()) {
    const bool held = name == "cam02" || name == "cam05";
    EXPECT_EQ(params == start.at(name), held) << name;
  }
}

}  // namespace
}  // namespace mfir
