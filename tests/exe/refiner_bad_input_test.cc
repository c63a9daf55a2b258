// What the refiner does with frames and rigs that cannot work: exit code and
// message.

#include <random>

#include "colmap_ext/models/camera_models.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class BadInputTest : public RefinerTest {
 protected:
  // Replaces a word of a text file. `line` counts lines without '#'.
  void SetWord(const std::string& name,
               size_t line,
               size_t word,
               const std::string& value) const {
    std::istringstream file(ReadFile(Path(name)));
    std::string text, content;
    size_t number = 0;
    while (std::getline(file, text)) {
      if (text.empty() || text[0] != '#') {
        if (number++ == line) {
          std::vector<std::string> words;
          std::istringstream stream(text);
          for (std::string w; stream >> w;) words.push_back(w);
          ASSERT_LT(word, words.size());
          words[word] = value;
          text.clear();
          for (const std::string& w : words) text += w + " ";
        }
      }
      content += text + "\n";
    }
    WriteFile(Path(name), content);
  }

  // Makes all frames text models in FRAME/.
  void UseTextModels() const {
    for (const char* frame : {"frame000000", "frame000001", "frame000002"}) {
      const host::Reconstruction model = Read(ModelPath(frame));
      fs::remove_all(Path(std::string("frames/") + frame));
      WriteText(model, Path(std::string("frames/") + frame));
    }
  }
};

TEST_F(BadInputTest, FoldersWithoutFrames) {
  fs::create_directories(Path("empty"));
  fs::create_directories(Path("hollow/a"));
  fs::create_directories(Path("hollow/b/sparse/0"));
  ExpectError(
      kExitBadInput, {"empty", "sub-folder"}, {{"input_path", Path("empty")}});
  ExpectError(kExitBadInput,
              {"hollow", "no sparse model"},
              {{"input_path", Path("hollow")}});
  EXPECT_FALSE(fs::exists(Path("out/summary.json")));
}

TEST_F(BadInputTest, MissingPaths) {
  const std::string missing = Path("missing");
  for (const char* name :
       {"input_path", "extrinsics_path", "ground_truth_path"}) {
    ExpectError(kExitBadInput, {missing}, {{name, missing}});
  }
  ExpectError(kExitBadInput,
              {missing, "--frame_list_path"},
              {{"frame_list_path", missing}});
  ExpectError(
      kExitUsage, {missing, "--project_path"}, {{"project_path", missing}});
  EXPECT_NE(Refine({{"image_path", missing}}).exit_code, kExitSuccess);
  for (const char* name : {"input_path", "extrinsics_path", "output_path"}) {
    ExpectError(kExitUsage, {name, "required"}, {{name, "-"}});
  }
}

TEST_F(BadInputTest, PathsTheSystemRejects) {
  fs::create_symlink("loop", Path("loop"));
  for (const std::string& path : {Path(std::string(300, 'x')), Path("loop")}) {
    ExpectError(kExitBadInput, {path}, {{"input_path", path}});
    ExpectError(kExitBadInput, {path}, {{"extrinsics_path", path}});
    ExpectError(kExitOutput, {path}, {{"output_path", path}});
  }
  // Links among the frames.
  fs::create_symlink("nowhere", Path("frames/dangling"));
  EXPECT_EQ(Refine().exit_code, kExitSuccess);
  fs::create_symlink("loop", Path("frames/loop"));
  ExpectError(kExitBadInput, {"frames/loop"});
}

TEST_F(BadInputTest, FrameList) {
  WriteFile(Path("list"), "frame000000\nframe000009\n");
  ExpectError(kExitBadInput,
              {"list:2", "frame000009"},
              {{"frame_list_path", Path("list")}});
  WriteFile(Path("list"), "\n\n");
  ExpectError(
      kExitBadInput, {"list", "no name"}, {{"frame_list_path", Path("list")}});
}

// Names of a frame list are names in FRAMES, not paths: they are also the names
// of what is written.
// A pipe would never end.
TEST_F(BadInputTest, OnlyRegularFilesAreRead) {
  ASSERT_EQ(RunShell("mkfifo " + Path("pipe")).exit_code, 0);
  for (const std::string& path : {Path("pipe"), std::string("/dev/zero")}) {
    for (const char* option : {"frame_list_path",
                               "constant_camera_list_path",
                               "extrinsics_path",
                               "ground_truth_path"}) {
      SCOPED_TRACE(option);
      ExpectError(kExitBadInput, {path}, {{option, path}});
    }
    ExpectError(kExitBadInput,
                {path},
                {{"extrinsics_path", path}, {"extrinsics_format", "krt"}});
    ExpectError(kExitUsage, {path}, {{"project_path", path}});
  }
  for (const char* name : {"rig/cameras.txt", "opencv/extri.yml"}) {
    const fs::path path = Path(name);
    fs::create_directories(path.parent_path());
    fs::remove(path);
    ASSERT_EQ(RunShell("mkfifo " + path.string()).exit_code, 0);
    const std::string folder = path.parent_path().string();
    ExpectError(kExitBadInput, {folder}, {{"extrinsics_path", folder}});
  }
}

TEST_F(BadInputTest, FrameListOfPathsNeverWritesToTheInput) {
  UseTextModels();
  const auto before = Files("frames");
  for (const std::string& name : {Path("frames/frame000000"),
                                  std::string("../frames/frame000000"),
                                  std::string("./frame000000")}) {
    WriteFile(Path("list"), name + "\nframe000001\n");
    ExpectError(kExitBadInput, {"list:1"}, {{"frame_list_path", Path("list")}});
    EXPECT_TRUE(before == Files("frames")) << name;
  }
}

TEST_F(BadInputTest, TruncatedBinaryModels) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    const std::string path = ModelPath("frame000001") + "/" + name;
    const std::string content = ReadFile(path);
    for (const double share : {0.0, 0.001, 0.3, 0.999}) {
      WriteFile(path, content.substr(0, size_t(share * content.size())));
      ExpectError(kExitBadInput, {path});
    }
    WriteFile(path, content + "garbage");
    ExpectError(kExitBadInput, {path});
    WriteFile(path, std::string(content.size(), '\xff'));
    ExpectError(kExitBadInput, {path});
    WriteFile(path, content);
  }
}

// A changed byte may go unnoticed (it may be a digit of a point), but never
// crashes or ends in something that is not a number.
TEST_F(BadInputTest, ChangedBytesOfBinaryModels) {
  std::mt19937 random(1);
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    const std::string path = ModelPath("frame000001") + "/" + name;
    const std::string content = ReadFile(path);
    for (int i = 0; i < 10; ++i) {
      std::string changed = content;
      const size_t end = i % 2 == 0 ? 200 : changed.size();
      changed[random() % end] = static_cast<char>(random() % 256);
      WriteFile(path, changed);
      const CommandResult result =
          Refine({{"MultiFrame.max_num_iterations", "15"}}, 20);
      if (result.exit_code == kExitSuccess) {
        for (const auto& [camera, params] : Params()) {
          for (const double value : params) {
            EXPECT_TRUE(std::isfinite(value)) << name << " " << i;
          }
        }
      } else {
        EXPECT_TRUE(result.exit_code == kExitBadInput ||
                    result.exit_code == kExitSolver)
            << name << " " << i << ": " << result.exit_code << result.error;
      }
    }
    WriteFile(path, content);
  }
}

TEST_F(BadInputTest, TextModelsNameFileAndLine) {
  UseTextModels();
  struct Case {
    std::string file;
    size_t line;
    size_t word;
    std::string value;
    std::string field;  // part of the message
  };
  const std::vector<Case> cases = {
      {"cameras.txt", 0, 1, "PINHOLES", "PINHOLES"},
      {"cameras.txt", 0, 2, "-640", "WIDTH"},
      {"cameras.txt", 0, 2, "0", "size"},
      {"cameras.txt", 0, 4, "nan", "finite"},
      {"cameras.txt", 0, 4, "inf", "finite"},
      {"cameras.txt", 0, 4, "0", "focal length"},
      {"cameras.txt", 0, 4, "-1000", "focal length"},
      {"cameras.txt", 0, 4, "1e300", "focal length"},
      {"cameras.txt", 0, 6, "-1e300", "principal point"},
      {"cameras.txt", 0, 4, "1000mm", "1000mm"},
      {"cameras.txt", 0, 4, "1e999", "1e999"},
      {"images.txt", 0, 1, "nan", "QW"},
      {"images.txt", 0, 5, "inf", "TX"},
      {"images.txt", 0, 5, "one", "one"},
      {"images.txt", 0, 8, "77", "77"},
      {"images.txt", 1, 0, "nan", "POINTS2D"},
      {"images.txt", 1, 0, "1,5", "1,5"},
      {"points3D.txt", 0, 1, "nan", "X"},
      {"points3D.txt", 0, 3, "inf", "Z"},
      {"points3D.txt", 0, 2, "up", "up"}};
  for (const Case& c : cases) {
    const std::string name = "frames/frame000001/" + c.file;
    const std::string content = ReadFile(Path(name));
    SetWord(name, c.line, c.word, c.value);
    ExpectError(kExitBadInput, {Path(name), c.field});
    WriteFile(Path(name), content);
  }
  for (const char* file : {"cameras.txt", "images.txt", "points3D.txt"}) {
    const std::string path = Path(std::string("frames/frame000001/") + file);
    const std::string content = ReadFile(path);
    // In the middle of a line, and what is no text at all.
    WriteFile(path, content.substr(0, content.find('\n', 200) + 12));
    ExpectError(kExitBadInput, {path});
    WriteFile(path, std::string("\x00\x01\xff\xfe\n\x7f", 6));
    ExpectError(kExitBadInput, {path});
    fs::remove(path);
    EXPECT_NE(Refine().exit_code, kExitSolver);
    WriteFile(path, content);
  }
}

TEST_F(BadInputTest, DuplicateAndUnknownCameras) {
  ChangeFrame("frame000001", [](host::Reconstruction* model) {
    model->Image(2).SetName("a/cam02.png");
    model->Image(3).SetName("b/cam02.png");
  });
  ExpectError(kExitBadInput,
              {"a/cam02.png", "b/cam02.png", "camera_name_regex"},
              {{"MultiFrame.camera_name_regex", "(cam\\d+)"}});
}

TEST_F(BadInputTest, CamerasThatDifferBetweenFramesOrFromTheRig) {
  ChangeFrame("frame000001", [](host::Reconstruction* model) {
    model->Camera(4) = host::MakeCamera(4,
                                        host::ModelId(model->Camera(4)),
                                        641,
                                        480,
                                        host::Params(model->Camera(4)));
  });
  ExpectError(kExitBadInput, {"cam03", "frame000001", "641", "640"});
  ChangeFrame("frame000001", [](host::Reconstruction* model) {
    model->Camera(4) =
        host::MakeCamera(4,
                         CameraModelId(*FindCameraModel("SIMPLE_PINHOLE")),
                         640,
                         480,
                         {1700, 320, 240});
  });
  ExpectError(kExitBadInput,
              {"cam03", "frame000001", "SIMPLE_PINHOLE", "camera_model"});
  EXPECT_EQ(Refine({{"MultiFrame.camera_model", "PINHOLE"}}).exit_code,
            kExitSuccess);
}

// Not "a number", but no coordinate either: never a silent result.
TEST_F(BadInputTest, AbsurdMagnitudes) {
  for (const double value : {1e20, 1e200, 1e300}) {
    ChangeRig([&](host::Reconstruction* rig) {
      SetTranslation(1, Eigen::Vector3d(value, 0, 0), rig);
    });
    const CommandResult result = Refine();
    EXPECT_EQ(result.exit_code, kExitBadInput) << value << result.error;
    EXPECT_NE(result.error.find("1e15"), std::string::npos) << result.error;
  }
}

// The range of coordinates holds for points and KRT files as well.
TEST_F(BadInputTest, AbsurdPointsAndKRTTranslations) {
  ChangeFrame("frame000001", [](host::Reconstruction* model) {
    host::Xyz(&model->Point3D(1)) = Eigen::Vector3d(0, 1e200, 0);
  });
  ExpectError(kExitBadInput, {"point 1", "1e+200", "1e15"});
  WriteFile(Path("far.krt"),
            "cam00\n500 0 320\n0 500 240\n0 0 1\n0 0 0 0 0\n1 0 0 1e20\n0 1 0 "
            "0\n0 0 1 0\n\n");
  ExpectError(kExitBadInput,
              {"far.krt:1", "cam00", "1e+20"},
              {{"extrinsics_path", Path("far.krt")}});
}

TEST_F(BadInputTest, AbsurdKeypointDoesNotSpoilTheResult) {
  ExpectRefines();
  const CameraParams expected = Params();
  for (const double value : {1e10, 1e30, -1e30, 1e300}) {
    ChangeFrame("frame000001", [&](host::Reconstruction* model) {
      host::Image& image = model->Image(1);
      for (host::point2D_t i = 0; i < image.NumPoints2D(); ++i) {
        if (image.Point2D(i).HasPoint3D()) {
          host::SetXy(Eigen::Vector2d(value, 100), &image.Point2D(i));
          break;
        }
      }
    });
    const CommandResult result = Refine();
    if (result.exit_code == kExitSuccess) {
      EXPECT_LT(MaxRelativeDifference(expected, Params()), 1e-2) << value;
    } else {
      EXPECT_EQ(result.exit_code, kExitBadInput) << value << result.error;
    }
  }
}

TEST_F(BadInputTest, OnePointOrCameraFarOffIsAnOutlier) {
  ExpectRefines();
  const CameraParams expected = Params();
  ChangeFrame("frame000001", [](host::Reconstruction* model) {
    host::Xyz(&model->Point3D(1)) = Eigen::Vector3d(1e6, 0, 0);
    SetTranslation(3, Eigen::Vector3d(1e6, 0, 0), model);
    host::SetParams({1e5, 1e5, -1e4, 1e4}, &model->Camera(5));
  });
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), 1e-5);
}
TEST_F(BadInputTest, RigWithTooFewOrCoincidentCameras) {
  for (const size_t num_cameras : {2, 1, 0}) {
    ChangeRig([&](host::Reconstruction* rig) { KeepImages(num_cameras, rig); });
    ExpectError(kExitBadInput, {num_cameras == 0 ? "no camera" : "3 are"});
  }
  fs::remove_all(Path("rig"));
  fs::copy(Path("ground_truth"), Path("rig"));
  ChangeRig([](host::Reconstruction* rig) {
    for (const auto& [id, image] : rig->Images()) {
      host::SetCamFromWorld(Rigid3(), &rig->Image(id));
    }
  });
  ExpectError(kExitBadInput, {"known extrinsics"});
}

TEST_F(BadInputTest, RigFiles) {
  const std::string krt = ReadFile(Path("KRT"));
  ExpectError(kExitBadInput,
              {"cameras.txt:"},
              {{"extrinsics_path", Path("rig/cameras.txt")}});
  for (const std::string& content : {std::string(),
                                     std::string("nonsense\n"),
                                     krt.substr(0, krt.size() / 2 + 7),
                                     krt + krt,
                                     Replaced(krt, "\ncam01\n", "\ncam00\n"),
                                     std::string(1000, '\xff')}) {
    WriteFile(Path("KRT"), content);
    SCOPED_TRACE(content.substr(0, 100));
    ExpectError(
        kExitBadInput, {Path("KRT")}, {{"extrinsics_path", Path("KRT")}});
  }
  for (const char* format : {"krt", "opencv"}) {
    ExpectError(kExitBadInput, {Path("rig")}, {{"extrinsics_format", format}});
  }
}

// A ground truth that cannot be used is found before the work, not after it.
TEST_F(BadInputTest, GroundTruthIsCheckedFirst) {
  const CommandResult result = Refine({{"ground_truth_path", Path("missing")}});
  EXPECT_EQ(result.exit_code, kExitBadInput);
  EXPECT_EQ(result.output.find("Solve"), std::string::npos);
}

}  // namespace
}  // namespace mfir
