#include "colmap_ext/rigs/rig_io.h"

#include <cmath>
#include <limits>
#include <random>

#include "colmap_ext/models/camera_models.h"
#include "tests/support/test_data.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

const double kDefaultOffset = std::numeric_limits<double>::quiet_NaN();

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

Rig ReadFormat(const std::string& path,
               const std::string& format = "auto",
               double pixel_offset = kDefaultOffset) {
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
  const Rig rig = ReadFormat(folder / "KRT");
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
  ExpectSameCameras(ReadFormat(folder / "a").cameras,
                    ReadFormat(folder / "b").cameras);
}

TEST(ReadRig, KRTWithInvisibleCharacters) {
  const TemporaryFolder folder;
  WriteFile(folder / "a", kKRT);
  WriteFile(folder / "b", WithInvisibles(kKRT));
  ExpectSameCameras(ReadFormat(folder / "a").cameras,
                    ReadFormat(folder / "b").cameras);
}

TEST(ReadRig, PixelOffset) {
  const TemporaryFolder folder;
  WriteFile(folder / "KRT", kKRT);
  const Rig rig = ReadFormat(folder / "KRT", "krt", 0.5);
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
  const Rig first = ReadFormat(folder / "1");
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
  ExpectSameCameras(first.cameras, ReadFormat(folder / "2").cameras);
}

TEST(WriteKRT, ModelsOfCOLMAP) {
  const TemporaryFolder folder;
  std::vector<std::string> without_distortion = {"FOV",
                                                 "FULL_OPENCV",
                                                 "OPENCV_FISHEYE",
                                                 "RADIAL_FISHEYE",
                                                 "SIMPLE_RADIAL_FISHEYE",
                                                 "THIN_PRISM_FISHEYE"};
  for (const char* of_colmap4 : {"RAD_TAN_THIN_PRISM_FISHEYE",
                                 "SIMPLE_DIVISION",
                                 "DIVISION",
                                 "SIMPLE_FISHEYE",
                                 "FISHEYE",
                                 "EUCM"}) {
    if (FindCameraModel(of_colmap4) != nullptr) {
      without_distortion.push_back(of_colmap4);
    }
  }
  std::sort(without_distortion.begin(), without_distortion.end());
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
  for (const KnownCamera& read : ReadFormat(folder / "KRT").cameras) {
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
           {"500 0 320", "1e9 0 320", {":10: camera 000007", "1e7 px"}},
           {"500 0 320", "500 0 -1e9", {":10: camera 000007", "principal"}},
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
    ExpectInputError([&] { ReadFormat(folder / "KRT"); }, message);
  }
  WriteFile(folder / "empty", "\n");
  ExpectInputError([&] { ReadFormat(folder / "empty"); }, {"no camera"});
}

TEST(ReadRig, TruncatedKRT) {
  const TemporaryFolder folder;
  for (size_t size = 0; size < kKRT.size(); ++size) {
    WriteFile(folder / "KRT", kKRT.substr(0, size));
    try {
      EXPECT_LE(ReadFormat(folder / "KRT").cameras.size(), 3);
    } catch (const InputError&) {
    }
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
  const Rig rig = ReadFormat(folder.Path());
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

  EXPECT_EQ(ReadFormat(folder.Path(), "colmap", 0.5).cameras[0].params,
            std::vector<double>({1000, 960.5, 540.5, 0.1}));
  // Images that the regex does not match keep their own names.
  EXPECT_EQ(ReadRig(folder.Path(), "", CameraNaming("(x)"), kDefaultOffset)
                .cameras[0]
                .name,
            "camera000002_frame0.png");
  ExpectInputError(
      [&] {
        ReadRig(folder.Path(), "", CameraNaming("_(frame)"), kDefaultOffset);
      },
      {"camera000002_frame0.png", "both camera 'frame'"});
  WriteFile(folder / "images.txt", "");
  ExpectInputError([&] { ReadFormat(folder.Path()); }, {"no camera in it"});
}

TEST(ReadRig, Detection) {
  const TemporaryFolder folder;
  ExpectInputError([&] { ReadFormat(folder / "no"); },
                   {"no such file or folder", "cameras and images", "KRT"});
  ExpectInputError([&] { ReadFormat(folder.Path()); },
                   {"not a known rig format"});
  ExpectInputError([&] { ReadFormat(folder.Path(), "krt"); },
                   {"folder", "a file"});
  ExpectInputError([&] { ReadFormat(folder.Path(), "opencv"); }, {"extri.yml"});
  ExpectInputError([&] { ReadFormat(folder.Path(), "colmap"); }, {"cameras"});
  EXPECT_THROW(ReadFormat(folder.Path(), "bundler"), UsageError);
  // Forced formats win over what detection would find.
  WriteFile(folder / "KRT.yml", kKRT);
  ExpectInputError([&] { ReadFormat(folder / "KRT.yml"); }, {"OpenCV's YAML"});
  EXPECT_EQ(ReadFormat(folder / "KRT.yml", "krt").cameras.size(), 3);
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
    const Rig rig = ReadFormat(
        (TestDataFolder() / calibration.name / "calibration").string());
    EXPECT_EQ(rig.cameras.size(), calibration.num_cameras);
    // Through KRT and back.
    const TemporaryFolder folder;
    EXPECT_TRUE(WriteKRT(folder / "KRT", rig.cameras).empty());
    const Rig krt = ReadFormat(folder / "KRT");
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
