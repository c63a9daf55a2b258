#include "colmap_ext/rig_io.h"

#include <cmath>
#include <cstdio>
#include <limits>
#include <random>

#include "colmap_ext/camera_models.h"
#include "tests/test_data.h"
#include "tests/test_files.h"

namespace mfir {
namespace {

const double kNaN = std::numeric_limits<double>::quiet_NaN();

const std::string kKRT =
    "400015\n"
    "7467.25 0 950.398\n"
    "0 7467.15 639.297\n"
    "0 0 1\n"
    "0 0 0 0 0\n"
    "1 0 0 0.10000000000000001\n"
    "0 1 0 -1000.5\n"
    "0 0 1 2\n"
    "\n"
    "000007\n"
    "500 0 320\n"
    "0 501 240\n"
    "0 0 1\n"
    "0.1 -0.2 0.001 0.002 0\n"
    "0 -1 0 3\n"
    "1 0 0 4\n"
    "0 0 1 5\n"
    "\n"
    "38\n"
    "600 0 321\n"
    "0 601 241\n"
    "0 0 1\n"
    "0.1 -0.2 0.001 0.002 0.3\n"
    "1 0 0 6\n"
    "0 0 -1 7\n"
    "0 1 0 8\n";

const std::string kExtrinsics =
    "%YAML:1.0\n"
    "---\n"
    "names:\n"
    "  - \"01\"\n"
    "  - \"cam2\"\n"
    "R_01: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 1\n"
    "  dt: d\n"
    "  data: [0.000, 0.000, 1.5707963267948966]\n"
    "Rot_01: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 3\n"
    "  dt: d\n"
    "  data: [0, -1, 0.0, 1, 0, 0, 0, 0, 1]\n"
    "T_01: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 1\n"
    "  dt: d\n"
    "  data: [0.1, 2, 3.25]\n"
    "R_cam2: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 1\n"
    "  dt: d\n"
    "  data: [0.5, 0., 0.]\n"
    "T_cam2: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 1\n"
    "  dt: d\n"
    "  data: [4, 5, 6]\n";

const std::string kIntrinsics =
    "%YAML:1.0\n"
    "---\n"
    "names:\n"
    "  - \"01\"\n"
    "  - \"cam2\"\n"
    "K_01: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 3\n"
    "  dt: d\n"
    "  data: [1000.5, 0., 960, 0., 1001.5, 540, 0., 0., 1.]\n"
    "dist_01: !!opencv-matrix\n"
    "  rows: 1\n"
    "  cols: 5\n"
    "  dt: d\n"
    "  data: [0.1, -0.2, 0.001, 0.002, 0.]\n"
    "H_01: 1080\n"
    "W_01: 1920\n"
    "K_cam2: !!opencv-matrix\n"
    "  rows: 3\n"
    "  cols: 3\n"
    "  dt: d\n"
    "  data: [2000, 0., 961, 0., 2001, 541, 0., 0., 1.]\n"
    "dist_cam2: !!opencv-matrix\n"
    "  rows: 5\n"
    "  cols: 1\n"
    "  dt: d\n"
    "  data: [0.2, 0., 0., 0., 0.01]\n";

Rig Read(const std::string& path,
         const std::string& format = "auto",
         double pixel_offset = kNaN) {
  return ReadRig(path, format, CameraNaming(), pixel_offset);
}

void ExpectSameCameras(const std::vector<KnownCamera>& a,
                       const std::vector<KnownCamera>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].name, b[i].name);
    EXPECT_EQ(a[i].matrix.value(), b[i].matrix.value());
    EXPECT_EQ(a[i].cam_from_world.rotation.coeffs(),
              b[i].cam_from_world.rotation.coeffs());
    EXPECT_EQ(a[i].model, b[i].model);
    EXPECT_EQ(a[i].params, b[i].params);
  }
}

TEST(ReadRig, KRT) {
  const TemporaryFolder folder;
  WriteFile(folder / "KRT", kKRT);
  const Rig rig = Read(folder / "KRT");
  EXPECT_EQ(rig.format, "krt");
  ASSERT_EQ(rig.cameras.size(), 3);
  EXPECT_EQ(rig.cameras[0].name, "7");
  EXPECT_EQ(rig.cameras[0].image_name, "000007");
  EXPECT_EQ(rig.cameras[1].name, "38");
  EXPECT_EQ(rig.cameras[2].name, "400015");

  EXPECT_EQ(rig.cameras[0].model, FindCameraModel("OPENCV"));
  EXPECT_EQ(rig.cameras[0].params,
            std::vector<double>({500, 501, 320, 240, 0.1, -0.2, 0.001, 0.002}));
  EXPECT_EQ(rig.cameras[1].model, FindCameraModel("FULL_OPENCV"));
  EXPECT_EQ(rig.cameras[1].params,
            std::vector<double>(
                {600, 601, 321, 241, 0.1, -0.2, 0.001, 0.002, 0.3, 0, 0, 0}));
  EXPECT_EQ(rig.cameras[2].model, FindCameraModel("PINHOLE"));
  EXPECT_EQ(rig.cameras[2].params,
            std::vector<double>({7467.25, 7467.15, 950.398, 639.297}));
  EXPECT_EQ(rig.cameras[2].width, 0);

  EXPECT_EQ((*rig.cameras[2].matrix)(0, 3), 0.1);
  const Rigid3& pose = rig.cameras[0].cam_from_world;
  EXPECT_EQ(pose.translation, Eigen::Vector3d(3, 4, 5));
  EXPECT_LT((pose * Eigen::Vector3d(1, 2, 3) - Eigen::Vector3d(1, 5, 8)).norm(),
            1e-14);
}

TEST(ReadRig, KRTIsTolerantOfSpacing) {
  const TemporaryFolder folder;
  WriteFile(folder / "a", kKRT);
  std::string spaced = "\n\n";
  for (const char c : kKRT) {
    spaced += c == ' ' ? " \t " : c == '\n' ? " \r\n\n" : std::string(1, c);
  }
  WriteFile(folder / "b", spaced);
  ExpectSameCameras(Read(folder / "a").cameras, Read(folder / "b").cameras);
}

TEST(ReadRig, PixelOffset) {
  const TemporaryFolder folder;
  WriteFile(folder / "KRT", kKRT);
  const Rig rig = Read(folder / "KRT", "krt", 0.5);
  EXPECT_EQ(rig.cameras[0].params[2], 320.5);
  EXPECT_EQ(rig.cameras[0].params[3], 240.5);
}

TEST(WriteKRT, RoundTripIsBitIdentical) {
  const TemporaryFolder folder;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<KnownCamera> cameras(20);
  for (size_t i = 0; i < cameras.size(); ++i) {
    KnownCamera& camera = cameras[i];
    camera.name = std::to_string(400000 + i);
    Eigen::Vector4d q(
        normal(random), normal(random), normal(random), normal(random));
    q.normalize();
    camera.cam_from_world.rotation = Eigen::Quaterniond(q(0), q(1), q(2), q(3));
    camera.cam_from_world.translation =
        1e3 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    camera.model = FindCameraModel(i % 3 == 0   ? "PINHOLE"
                                   : i % 3 == 1 ? "OPENCV"
                                                : "FULL_OPENCV");
    camera.params = {1000 + normal(random),
                     1000 + normal(random),
                     500 + normal(random),
                     500 + normal(random)};
    while (camera.params.size() < camera.model->NumParams()) {
      camera.params.push_back(camera.params.size() < 9 ? normal(random) : 0.0);
    }
  }
  EXPECT_TRUE(WriteKRT(folder / "1", cameras).empty());
  const Rig first = Read(folder / "1");
  for (size_t i = 0; i < cameras.size(); ++i) {
    EXPECT_EQ(first.cameras[i].model, cameras[i].model);
    EXPECT_EQ(first.cameras[i].params, cameras[i].params);
    EXPECT_EQ(first.cameras[i].cam_from_world.translation,
              cameras[i].cam_from_world.translation);
    EXPECT_LT(first.cameras[i].cam_from_world.rotation.angularDistance(
                  cameras[i].cam_from_world.rotation),
              1e-14);
  }
  WriteKRT(folder / "2", first.cameras);
  EXPECT_EQ(ReadFile(folder / "1"), ReadFile(folder / "2"));
  ExpectSameCameras(first.cameras, Read(folder / "2").cameras);
}

TEST(WriteKRT, ModelsOfCOLMAP) {
  const TemporaryFolder folder;
  const std::vector<std::string> without_distortion = {"FOV",
                                                       "FULL_OPENCV",
                                                       "OPENCV_FISHEYE",
                                                       "RADIAL_FISHEYE",
                                                       "SIMPLE_RADIAL_FISHEYE",
                                                       "THIN_PRISM_FISHEYE"};
  std::vector<KnownCamera> cameras;
  for (const CameraModel* model : AllCameraModels()) {
    KnownCamera& camera = cameras.emplace_back();
    camera.name = model->Name();
    camera.model = model;
    camera.params.assign(model->NumParams(), 0.25);
    for (const size_t idx : model->FocalLengthIdxs()) {
      camera.params[idx] = 100.0 + idx;
    }
    for (const size_t idx : model->PrincipalPointIdxs()) {
      camera.params[idx] = 50.0 + idx;
    }
  }
  std::vector<std::string> reported = WriteKRT(folder / "KRT", cameras);
  std::sort(reported.begin(), reported.end());
  EXPECT_EQ(reported, without_distortion);
  const double uv[2] = {0.1, -0.2};
  for (const KnownCamera& read : Read(folder / "KRT").cameras) {
    for (const KnownCamera& written : cameras) {
      if (written.name != read.name) {
        continue;
      }
      double read_xy[2], written_xy[2];
      read.model->Project(read.params.data(), uv[0], uv[1], read_xy);
      written.model->Project(written.params.data(), uv[0], uv[1], written_xy);
      const bool is_same = std::abs(read_xy[0] - written_xy[0]) < 1e-12 &&
                           std::abs(read_xy[1] - written_xy[1]) < 1e-12;
      const bool is_reported =
          std::binary_search(reported.begin(), reported.end(), read.name);
      EXPECT_EQ(is_same, !is_reported) << read.name;
    }
  }
}

TEST(WriteKRT, UnwritablePath) {
  const TemporaryFolder folder;
  try {
    WriteKRT(folder / "no/KRT", {});
    ADD_FAILURE();
  } catch (const OutputError& error) {
    EXPECT_NE(std::string(error.what()).find("no/KRT"), std::string::npos);
  }
}

TEST(ReadRig, BadKRT) {
  struct Bad {
    std::string from;
    std::string to;
    std::vector<std::string> message;
  };
  const TemporaryFolder folder;
  for (const Bad& bad : std::vector<Bad>{
           {"500 0 320", "500 0", {":11:", "row 1 of K of camera 000007"}},
           {"500 0 320", "500 0 320 1", {":11:", "'1'"}},
           {"500 0 320", "500 0 3x0", {":11:", "3x0"}},
           {"500 0 320", "500 0 nan", {":11:", "not finite"}},
           {"500 0 320", "0 0 320", {":10: camera 000007", "positive"}},
           {"500 0 320", "500 0.1 320", {":10: camera 000007", "skew"}},
           {"0.002 0\n", "0.002\n", {":14:", "distortion"}},
           {"0 -1 0 3", "0 1 0 3", {":10: camera 000007", "not a rotation"}},
           {"0 -1 0 3", "0 -1.001 0 3", {":10:", "not a rotation"}},
           {"0 -1 0 3", "0 -1 0", {":15:", "[R | t]"}},
           {"0 -1 0 3", "0 -1 0 inf", {":15:", "not finite"}},
           {"000007", "400015", {"both camera '400015'"}},
           {"000007", "38", {"both camera '38'"}},
           {"0 1 0 8\n", "", {":25:", "ends within camera 38"}}}) {
    WriteFile(folder / "KRT", Replaced(kKRT, bad.from, bad.to));
    std::vector<std::string> message = bad.message;
    message.push_back(folder / "KRT");
    ExpectInputError([&] { Read(folder / "KRT"); }, message);
  }
  WriteFile(folder / "empty", "\n");
  ExpectInputError([&] { Read(folder / "empty"); }, {"no camera"});
}

TEST(ReadRig, TruncatedKRT) {
  const TemporaryFolder folder;
  for (size_t size = 0; size < kKRT.size(); ++size) {
    WriteFile(folder / "KRT", kKRT.substr(0, size));
    try {
      EXPECT_LE(Read(folder / "KRT").cameras.size(), 3);
    } catch (const InputError&) {
    }
  }
}

TEST(ReadRig, OpenCV) {
  const TemporaryFolder folder;
  WriteFile(folder / "extri.yml", kExtrinsics);
  WriteFile(folder / "intri.yml", kIntrinsics);
  const Rig rig = Read(folder.Path());
  EXPECT_EQ(rig.format, "opencv");
  ASSERT_EQ(rig.cameras.size(), 2);
  const KnownCamera& first = rig.cameras[0];
  EXPECT_EQ(first.name, "1");
  EXPECT_EQ(first.image_name, "01");
  EXPECT_EQ(first.model, FindCameraModel("OPENCV"));
  EXPECT_EQ(first.params,
            std::vector<double>(
                {1000.5, 1001.5, 960.5, 540.5, 0.1, -0.2, 0.001, 0.002}));
  EXPECT_EQ(first.width, 1920);
  EXPECT_EQ(first.height, 1080);
  Eigen::Matrix<double, 3, 4> matrix;
  matrix << 0, -1, 0, 0.1, 1, 0, 0, 2, 0, 0, 1, 3.25;
  EXPECT_EQ(first.matrix.value(), matrix);
  EXPECT_LT(
      (first.cam_from_world.rotation.toRotationMatrix() - matrix.leftCols<3>())
          .norm(),
      1e-14);

  const KnownCamera& second = rig.cameras[1];
  EXPECT_EQ(second.name, "cam2");
  EXPECT_EQ(second.model, FindCameraModel("FULL_OPENCV"));
  EXPECT_EQ(second.params[4], 0.2);
  EXPECT_EQ(second.params[8], 0.01);
  EXPECT_EQ(second.width, 0);
  EXPECT_FALSE(second.matrix.has_value());
  EXPECT_LT(second.cam_from_world.rotation.angularDistance(Eigen::Quaterniond(
                Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitX()))),
            1e-14);

  // Each of the two files stands for the pair.
  for (const char* name : {"extri.yml", "intri.yml"}) {
    EXPECT_EQ(Read(folder / name).cameras[0].params, first.params);
  }
  EXPECT_EQ(Read(folder.Path(), "opencv", 0.0).cameras[0].params[2], 960);
  // The matrices survive KRT.
  WriteKRT(folder / "KRT", {first});
  EXPECT_EQ(Read(folder / "KRT").cameras[0].matrix.value(), matrix);
}

TEST(ReadRig, OpenCVWithoutIntrinsicsAndWithNumbersAsNames) {
  const TemporaryFolder folder;
  WriteFile(folder / "extri.yml", Replaced(kExtrinsics, "- \"01\"", "- 1"));
  const Rig rig = Read(folder.Path());
  ASSERT_EQ(rig.cameras.size(), 2);
  EXPECT_EQ(rig.cameras[0].name, "1");
  EXPECT_EQ(rig.cameras[0].cam_from_world.translation(0), 0.1);
  EXPECT_EQ(rig.cameras[0].model, nullptr);
  EXPECT_TRUE(rig.cameras[0].params.empty());
}

TEST(ReadRig, OpenCVSingleFile) {
  const TemporaryFolder folder;
  const size_t intrinsics_begin = kIntrinsics.find("K_01");
  WriteFile(folder / "rig.yaml",
            kExtrinsics + kIntrinsics.substr(intrinsics_begin));
  EXPECT_EQ(Read(folder / "rig.yaml").cameras[0].params[0], 1000.5);
}

TEST(ReadRig, BadOpenCV) {
  struct Bad {
    std::string file;
    std::string from;
    std::string to;
    std::vector<std::string> message;
  };
  const TemporaryFolder folder;
  for (const Bad& bad : std::vector<Bad>{
           {"extri.yml", "%YAML:1.0", "yaml", {"extri.yml", "%YAML:1.0"}},
           {"extri.yml", "%YAML:1.0", "%YAML:1.0\n\tx: 1", {"extri.yml"}},
           {"extri.yml", "names:", "namen:", {"extri.yml", "names"}},
           {"extri.yml", "- \"cam2\"", "- \"cam3\"", {"T_cam3", "missing"}},
           {"extri.yml", "- \"cam2\"", "- \"1\"", {"both camera '1'"}},
           {"extri.yml", "- \"cam2\"", "- 1.5", {"names"}},
           {"extri.yml", "T_01:", "t_01:", {"extri.yml", "T_01", "missing"}},
           {"extri.yml", "R_cam2:", "r_cam2:", {"Rot_cam2", "both missing"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5]", {"T_cam2", "2 elements"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, .Nan]", {"T_cam2", "element 3"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, a]", {"T_cam2", "element 3"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, 6", {"extri.yml"}},
           {"extri.yml", "[0, -1,", "[0, 1,", {"camera 01", "rotation"}},
           {"extri.yml", "1.5707963", "1.6707963", {"Rot_01 and R_01"}},
           {"intri.yml", "K_cam2", "K_cam3", {"intri.yml", "K_cam2"}},
           {"intri.yml", "[2000, 0.", "[-1, 0.", {"camera cam2", "positive"}},
           {"intri.yml", "[2000, 0.", "[2000, 1.", {"camera cam2", "skew"}},
           {"intri.yml", "W_01: 1920", "W_01: 0", {"W_01"}},
           {"intri.yml", "W_01: 1920", "W_01: x", {"W_01"}},
           {"intri.yml",
            "[0.2, 0., 0., 0., 0.01]",
            "[0, 0, 0, 0, 0, 0, 0, 0, 1.]",
            {"camera cam2", "distortion"}}}) {
    WriteFile(folder / "extri.yml", kExtrinsics);
    WriteFile(folder / "intri.yml", kIntrinsics);
    const std::string path = folder / bad.file;
    WriteFile(path, Replaced(ReadFile(path), bad.from, bad.to));
    ExpectInputError([&] { Read(folder.Path()); }, bad.message);
  }
  std::filesystem::remove(folder / "extri.yml");
  ExpectInputError([&] { Read(folder.Path()); }, {"extri.yml", "no such file"});
}

TEST(ReadRig, GarbledOpenCVNeverCrashes) {
  const TemporaryFolder folder;
  WriteFile(folder / "intri.yml", kIntrinsics);
  const auto try_read = [&](const std::string& extrinsics) {
    WriteFile(folder / "extri.yml", extrinsics);
    try {
      Read(folder.Path());
    } catch (const InputError&) {
    }
  };
  for (size_t size = 0; size < kExtrinsics.size(); ++size) {
    try_read(kExtrinsics.substr(0, size));
  }
  std::mt19937 random(4);
  for (size_t trial = 0; trial < 3000; ++trial) {
    std::string changed = kExtrinsics;
    for (size_t i = 0; i <= random() % 3; ++i) {
      changed[random() % changed.size()] = static_cast<char>(random());
    }
    try_read(changed);
  }
}

TEST(ReadRig, Colmap) {
  const TemporaryFolder folder;
  WriteFile(folder / "cameras.txt",
            "1 PINHOLE 640 480 500 501 320 240\n"
            "2 SIMPLE_RADIAL 1920 1080 1000 960 540 0.1\n");
  WriteFile(folder / "images.txt",
            "1 1 0 0 0 0.5 -1.5 2 1 camera000012_frame0.png\n\n"
            "2 0 1 0 0 1 2 3 2 camera000002_frame0.png\n\n");
  const Rig rig = Read(folder.Path());
  EXPECT_EQ(rig.format, "colmap");
  ASSERT_EQ(rig.cameras.size(), 2);
  EXPECT_EQ(rig.cameras[0].name, "2");
  EXPECT_EQ(rig.cameras[0].image_name, "camera000002_frame0.png");
  EXPECT_EQ(rig.cameras[0].model, FindCameraModel("SIMPLE_RADIAL"));
  EXPECT_EQ(rig.cameras[0].params, std::vector<double>({1000, 960, 540, 0.1}));
  EXPECT_EQ(rig.cameras[0].width, 1920);
  EXPECT_FALSE(rig.cameras[0].matrix.has_value());
  EXPECT_EQ(rig.cameras[1].name, "12");
  EXPECT_EQ(rig.cameras[1].cam_from_world.translation,
            Eigen::Vector3d(0.5, -1.5, 2));

  EXPECT_EQ(Read(folder.Path(), "colmap", 0.5).cameras[0].params,
            std::vector<double>({1000, 960.5, 540.5, 0.1}));
  // Images that the regex does not match keep their own names.
  EXPECT_EQ(
      ReadRig(folder.Path(), "", CameraNaming("(x)"), kNaN).cameras[0].name,
      "camera000002_frame0.png");
  ExpectInputError(
      [&] { ReadRig(folder.Path(), "", CameraNaming("_(frame)"), kNaN); },
      {"camera000002_frame0.png", "both camera 'frame'"});
  WriteFile(folder / "images.txt", "");
  ExpectInputError([&] { Read(folder.Path()); }, {"no camera in it"});
}

TEST(ReadRig, Detection) {
  const TemporaryFolder folder;
  ExpectInputError([&] { Read(folder / "no"); },
                   {"no such file or folder", "cameras and images", "KRT"});
  ExpectInputError([&] { Read(folder.Path()); }, {"not a known rig format"});
  ExpectInputError([&] { Read(folder.Path(), "krt"); }, {"no such file"});
  ExpectInputError([&] { Read(folder.Path(), "opencv"); }, {"extri.yml"});
  ExpectInputError([&] { Read(folder.Path(), "colmap"); }, {"cameras"});
  EXPECT_THROW(Read(folder.Path(), "kalibr"), UsageError);
  // Forced formats win over what detection would find.
  WriteFile(folder / "KRT.yml", kKRT);
  ExpectInputError([&] { Read(folder / "KRT.yml"); }, {"%YAML:1.0"});
  EXPECT_EQ(Read(folder / "KRT.yml", "krt").cameras.size(), 3);
}

TEST(ReadRig, RealCalibrations) {
  struct Calibration {
    std::string name;
    size_t num_cameras;
  };
  for (const Calibration& calibration :
       {Calibration{"panoptic31", 31},
        Calibration{"robovision12", 12},
        Calibration{"strecha_herz_jesus_p8", 8}}) {
    MFIR_REQUIRE_TEST_DATA(calibration.name);
    const Rig rig =
        Read((TestDataFolder() / calibration.name / "calibration").string());
    EXPECT_EQ(rig.cameras.size(), calibration.num_cameras);
    // Through KRT and back.
    const TemporaryFolder folder;
    EXPECT_TRUE(WriteKRT(folder / "KRT", rig.cameras).empty());
    const Rig krt = Read(folder / "KRT");
    ASSERT_EQ(krt.cameras.size(), rig.cameras.size());
    for (size_t i = 0; i < rig.cameras.size(); ++i) {
      EXPECT_EQ(krt.cameras[i].name, rig.cameras[i].name);
      EXPECT_EQ(krt.cameras[i].params, rig.cameras[i].params);
      EXPECT_EQ(krt.cameras[i].cam_from_world.translation,
                rig.cameras[i].cam_from_world.translation);
    }
  }
}

}  // namespace
}  // namespace mfir
