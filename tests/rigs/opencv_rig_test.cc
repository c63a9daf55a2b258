// ReadRig on OpenCV's intri.yml and extri.yml.

#include <limits>
#include <random>

#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

const double kNoOffset = std::numeric_limits<double>::quiet_NaN();

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

Rig ReadOpenCv(const std::string& path,
               const std::string& format = "auto",
               double pixel_offset = kNoOffset) {
  return ReadRig(path, format, CameraNaming(), pixel_offset);
}

TEST(ReadRig, OpenCV) {
  const TemporaryFolder folder;
  WriteFile(folder / "extri.yml", kExtrinsics);
  WriteFile(folder / "intri.yml", kIntrinsics);
  const Rig rig = ReadOpenCv(folder.Path());
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
    EXPECT_EQ(ReadOpenCv(folder / name).cameras[0].params, first.params);
  }
  EXPECT_EQ(ReadOpenCv(folder.Path(), "opencv", 0.0).cameras[0].params[2], 960);
  // The matrices survive KRT.
  WriteKRT(folder / "KRT", {first});
  EXPECT_EQ(ReadOpenCv(folder / "KRT").cameras[0].matrix.value(), matrix);
}

TEST(ReadRig, OpenCVWithoutIntrinsicsAndWithNumbersAsNames) {
  const TemporaryFolder folder;
  WriteFile(folder / "extri.yml", Replaced(kExtrinsics, "- \"01\"", "- 1"));
  const Rig rig = ReadOpenCv(folder.Path());
  ASSERT_EQ(rig.cameras.size(), 2);
  EXPECT_EQ(rig.cameras[0].name, "1");
  EXPECT_EQ(rig.cameras[0].cam_from_world.translation(0), 0.1);
  EXPECT_EQ(rig.cameras[0].model, nullptr);
  EXPECT_TRUE(rig.cameras[0].params.empty());
}

TEST(ReadRig, OpenCVWithInvisibleCharacters) {
  const TemporaryFolder folder;
  WriteFile(folder / "a/extri.yml", kExtrinsics);
  WriteFile(folder / "a/intri.yml", kIntrinsics);
  WriteFile(folder / "b/extri.yml", WithInvisibles(kExtrinsics));
  WriteFile(folder / "b/intri.yml", WithInvisibles(kIntrinsics));
  const Rig a = ReadOpenCv(folder / "a");
  const Rig b = ReadOpenCv(folder / "b");
  ASSERT_EQ(b.cameras.size(), 2);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(b.cameras[i].name, a.cameras[i].name);
    EXPECT_EQ(b.cameras[i].params, a.cameras[i].params);
    EXPECT_EQ(b.cameras[i].cam_from_world.rotation.coeffs(),
              a.cameras[i].cam_from_world.rotation.coeffs());
    EXPECT_EQ(b.cameras[i].cam_from_world.translation,
              a.cameras[i].cam_from_world.translation);
  }
}

TEST(ReadRig, OpenCVSingleFile) {
  const TemporaryFolder folder;
  const size_t intrinsics_begin = kIntrinsics.find("K_01");
  WriteFile(folder / "rig.yaml",
            kExtrinsics + kIntrinsics.substr(intrinsics_begin));
  EXPECT_EQ(ReadOpenCv(folder / "rig.yaml").cameras[0].params[0], 1000.5);
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
           {"extri.yml", "%YAML:1.0", "yaml", {"extri.yml", "OpenCV's YAML"}},
           {"extri.yml", "%YAML:1.0", "%YAML:1.0\n\tx: 1", {"extri.yml"}},
           {"extri.yml", "names:", "namen:", {"extri.yml", "names"}},
           {"extri.yml", "- \"cam2\"", "- \"cam3\"", {"T_cam3", "missing"}},
           {"extri.yml", "- \"cam2\"", "- \"1\"", {"both camera '1'"}},
           {"extri.yml", "- \"cam2\"", "- [1]", {"names"}},
           {"extri.yml", "- \"cam2\"", "- \"\"", {"names"}},
           {"extri.yml", "T_01:", "t_01:", {"extri.yml", "T_01", "missing"}},
           {"extri.yml", "R_cam2:", "r_cam2:", {"Rot_cam2", "both missing"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5]", {"T_cam2", "2 elements"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, .Nan]", {"T_cam2", "element 3"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, a]", {"T_cam2", "element 3"}},
           {"extri.yml", "[4, 5, 6]", "[4, 5, 6", {"extri.yml"}},
           {"extri.yml", "[0, -1,", "[0, 1,", {"camera 01", "rotation"}},
           {"extri.yml", "1.5707963", "1.6707963", {"Rot_01 and R_01"}},
           {"intri.yml", "K_cam2", "K_01", {"intri.yml", "K_01", "twice"}},
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
    ExpectInputError([&] { ReadOpenCv(folder.Path()); }, bad.message);
  }
  std::filesystem::remove(folder / "extri.yml");
  ExpectInputError([&] { ReadOpenCv(folder.Path()); },
                   {"extri.yml", "no such file"});
}

TEST(ReadRig, GarbledOpenCVNeverCrashes) {
  const TemporaryFolder folder;
  WriteFile(folder / "intri.yml", kIntrinsics);
  const auto try_read = [&](const std::string& extrinsics) {
    WriteFile(folder / "extri.yml", extrinsics);
    try {
      ReadOpenCv(folder.Path());
    } catch (const InputError&) {
    }
  };
  for (size_t size = 0; size < kExtrinsics.size(); ++size) {
    try_read(kExtrinsics.substr(0, size));
  }
  std::mt19937 random(4);
  for (size_t trial = 0; trial < 1000; ++trial) {
    std::string changed = kExtrinsics;
    for (size_t i = 0; i <= random() % 3; ++i) {
      changed[random() % changed.size()] = static_cast<char>(random());
    }
    try_read(changed);
  }
}

}  // namespace
}  // namespace mfir
