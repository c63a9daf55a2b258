// Every rig format: a hand-computed example, a round trip through every pair of
// formats, and bad input.

#include <cmath>
#include <limits>
#include <tuple>

#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/rigs/rig_io.h"
#include "tests/support/rig_examples.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

const double kFormatOffset = std::numeric_limits<double>::quiet_NaN();

Rig ReadAny(const std::string& path, const std::string& format = "auto") {
  return ReadRig(path, format, CameraNaming(), kFormatOffset);
}

Eigen::Vector2d Project(const KnownCamera& camera, const Eigen::Vector3d& xyz) {
  const Eigen::Vector3d ray = camera.cam_from_world * xyz;
  Eigen::Vector2d xy;
  camera.model->Project(
      camera.params.data(), ray.x() / ray.z(), ray.y() / ray.z(), xy.data());
  return xy;
}

const KnownCamera& Find(const Rig& rig, const std::string& name) {
  for (const KnownCamera& camera : rig.cameras) {
    if (camera.name == name) return camera;
  }
  throw std::runtime_error("no camera " + name);
}

class RigFormatTest : public testing::TestWithParam<RigExample> {
 protected:
  const TemporaryFolder folder_;
};

// See rig_examples.h for the numbers.
TEST_P(RigFormatTest, HandComputedProjection) {
  const RigExample& example = GetParam();
  const Rig rig = ReadAny(example.Write(folder_.Path()));
  EXPECT_EQ(rig.format, example.format);
  ASSERT_EQ(rig.cameras.size(), 2);
  const KnownCamera& a = Find(rig, "a");
  const KnownCamera& b = Find(rig, "b");
  EXPECT_LT((a.cam_from_world.Center() - Eigen::Vector3d(1, 2, 3)).norm(),
            1e-12);
  const Eigen::Vector3d xyz(11, 1, 5);
  const Eigen::Vector2d in_a = example.has_distortion
                                   ? Eigen::Vector2d(422.0, 60.05)
                                   : Eigen::Vector2d(420.5, 60.5);
  EXPECT_LT((Project(a, xyz) - in_a).norm(), 1e-9) << Project(a, xyz);
  EXPECT_LT((Project(b, xyz) - Eigen::Vector2d(1420, 340)).norm(), 1e-9)
      << Project(b, xyz);
  EXPECT_EQ(a.width, example.has_size ? 640 : 0);
  EXPECT_EQ(b.height, example.has_size ? 480 : 0);
}

TEST_P(RigFormatTest, PixelOffsetAddsToPrincipalPoints) {
  const std::string path = GetParam().Write(folder_.Path());
  const Rig rig = ReadRig(path, "auto", CameraNaming(), kFormatOffset);
  const Rig shifted = ReadRig(path, "auto", CameraNaming(), 7.0);
  const double offset =
      7.0 - FindRigFormat("format", GetParam().format).pixel_offset;
  for (size_t i = 0; i < 2; ++i) {
    for (const size_t idx : rig.cameras[i].model->PrincipalPointIdxs()) {
      EXPECT_NEAR(shifted.cameras[i].params[idx],
                  rig.cameras[i].params[idx] + offset,
                  1e-9);
    }
  }
}

TEST_P(RigFormatTest, CutOffFilesAreErrors) {
  const RigExample& example = GetParam();
  // Of two files, the one with the poses.
  const auto& [name, content] = example.files.back();
  for (const double share : {0.0, 0.1, 0.5, 0.8}) {
    const std::string path = example.Write(folder_.Path());
    WriteFile(folder_ / name,
              content.substr(0, static_cast<size_t>(share * content.size())));
    EXPECT_THROW(ReadAny(path, example.format), InputError)
        << example.format << " " << share;
  }
}

INSTANTIATE_TEST_SUITE_P(Formats,
                         RigFormatTest,
                         testing::ValuesIn(RigExamples()),
                         [](const auto& info) { return info.param.format; });

std::vector<KnownCamera> RandomCameras(const std::string& model_name) {
  std::vector<KnownCamera> cameras;
  for (int i = 0; i < 3; ++i) {
    KnownCamera& camera = cameras.emplace_back();
    camera.name = "cam0" + std::to_string(i);
    camera.image_name = camera.name + ".png";
    camera.cam_from_world.rotation =
        Eigen::Quaterniond(0.3 + i, 0.2, -0.7 + 0.1 * i, 0.5).normalized();
    camera.cam_from_world.translation =
        Eigen::Vector3d(1.0 / 3.0 + i, -2.0 / 7.0, 100.0 / 9.0);
    camera.width = 1600;
    camera.height = 1201;
    camera.model = FindCameraModel(model_name);
    camera.params.assign(camera.model->NumParams(), 0.01 + 0.001 * i);
    for (const size_t idx : camera.model->FocalLengthIdxs()) {
      camera.params[idx] = 1500.0 + 1.0 / 3.0 + 10.0 * idx + i;
    }
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      camera.params[idx] = 800.1 - 100.0 * idx + i / 3.0;
    }
  }
  return cameras;
}

// Poses relative to the first camera, since two formats hold no world.
void ExpectSameRig(const std::vector<KnownCamera>& expected,
                   const std::vector<KnownCamera>& actual,
                   bool has_distortion) {
  ASSERT_EQ(expected.size(), actual.size());
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_EQ(expected[i].name, actual[i].name);
    const auto relative = [i](const std::vector<KnownCamera>& cameras) {
      const Rigid3& first = cameras[0].cam_from_world;
      const Rigid3& pose = cameras[i].cam_from_world;
      const Eigen::Quaterniond q = pose.rotation * first.rotation.conjugate();
      return Rigid3{q, pose.translation - q * first.translation};
    };
    EXPECT_LT(
        relative(expected).rotation.angularDistance(relative(actual).rotation),
        1e-13);
    EXPECT_LT(
        (relative(expected).translation - relative(actual).translation).norm(),
        1e-12);
    if (actual[i].width > 0) {
      EXPECT_EQ(expected[i].width, actual[i].width);
      EXPECT_EQ(expected[i].height, actual[i].height);
    }
    for (const Eigen::Vector2d& uv :
         {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(0.3, -0.2)}) {
      if (!has_distortion && uv.norm() > 0.0) continue;
      Eigen::Vector2d xy[2];
      expected[i].model->Project(
          expected[i].params.data(), uv.x(), uv.y(), xy[0].data());
      actual[i].model->Project(
          actual[i].params.data(), uv.x(), uv.y(), xy[1].data());
      EXPECT_LT((xy[0] - xy[1]).norm(), 1e-9) << xy[0] << "\n" << xy[1];
    }
  }
}

// What goes in comes out, through every pair of formats that can hold it.
TEST(RigFormats, RoundTripThroughEveryPair) {
  for (const char* model : {"PINHOLE", "OPENCV", "OPENCV_FISHEYE"}) {
    const std::string name = model;
    const std::vector<KnownCamera> cameras = RandomCameras(name);
    const auto holds = [&name](const RigFormat& format) {
      if (name == "PINHOLE") return true;
      if (format.name == "csv" || format.name == "npz") return false;
      return name == "OPENCV" ||
             (format.name != "krt" && format.name != "opencv" &&
              format.name != "panoptic" && format.name != "multical");
    };
    for (const RigFormat& first : RigFormats()) {
      for (const RigFormat& second : RigFormats()) {
        if (!holds(first) || !holds(second)) continue;
        SCOPED_TRACE(name + ": " + first.name + " to " + second.name);
        const TemporaryFolder folder;
        WriteRig(folder / "1", first, cameras);
        Rig rig = ReadAny(folder / "1");
        ASSERT_EQ(rig.format, first.name);
        for (KnownCamera& camera : rig.cameras) {
          if (camera.width > 0) continue;
          EXPECT_TRUE(first.name == "krt" || first.name == "rig_config");
          camera.width = cameras[0].width;
          camera.height = cameras[0].height;
        }
        WriteRig(folder / "2", second, rig.cameras);
        const Rig again = ReadAny(folder / "2");
        ASSERT_EQ(again.format, second.name);
        ExpectSameRig(cameras, again.cameras, true);
      }
    }
  }
}

TEST(RigFormats, WhatCannotBeHeldIsSaid) {
  const TemporaryFolder folder;
  const auto remarks_of = [&](const std::string& format,
                              const std::string& model) {
    std::string lines;
    for (const std::string& remark : WriteRig(folder / format,
                                              FindRigFormat("format", format),
                                              RandomCameras(model))) {
      lines += remark + "\n";
    }
    return lines;
  };
  for (const auto& [format, model, part] :
       std::vector<std::tuple<std::string, std::string, std::string>>{
           {"csv", "OPENCV", "csv cannot hold the distortion of 3 cameras"},
           {"npz", "OPENCV", "npz cannot hold the distortion of 3 cameras"},
           {"krt", "FOV", "KRT cannot hold the distortion of camera 'cam00'"},
           {"krt", "PINHOLE", "KRT holds no image sizes"},
           {"rig_config", "FOV", "holds no world"},
           {"kalibr", "PINHOLE", "holds no world"},
           {"kalibr", "FULL_OPENCV", "the closest OPENCV lens is written"},
           {"transforms", "THIN_PRISM_FISHEYE", "the closest OPENCV lens"},
           {"panoptic", "OPENCV_FISHEYE", "up to"}}) {
    EXPECT_NE(remarks_of(format, model).find(part), std::string::npos)
        << format << " " << model << ": " << remarks_of(format, model);
  }
  EXPECT_EQ(remarks_of("metashape", "OPENCV_FISHEYE"), "");
  EXPECT_EQ(remarks_of("multical", "FULL_OPENCV"), "");
  EXPECT_EQ(remarks_of("transforms", "RADIAL_FISHEYE"), "");
  // The principal point and the focal length stay.
  ExpectSameRig(
      RandomCameras("OPENCV"), ReadAny(folder / "csv").cameras, false);
}

TEST(RigFormats, WhatAFormatNeedsIsAnError) {
  const TemporaryFolder folder;
  std::vector<KnownCamera> cameras = RandomCameras("PINHOLE");
  cameras[1].width = 0;
  for (const char* format : {"colmap", "metashape", "csv", "kalibr"}) {
    ExpectInputError(
        [&]() { WriteRig(folder / "rig", FindRigFormat("", format), cameras); },
        {"'cam01'", "image size", "--image_path"});
    EXPECT_FALSE(std::filesystem::exists(folder / "rig"));
    EXPECT_FALSE(std::filesystem::exists(WorkFolder::Beside(folder / "rig")));
  }
  cameras[1].model = nullptr;
  ExpectInputError(
      [&]() { WriteRig(folder / "rig", FindRigFormat("", "krt"), cameras); },
      {"'cam01'", "no intrinsics"});
  EXPECT_TRUE(WriteRig(folder / "rig", FindRigFormat("", "rig_config"), cameras)
                  .size() > 0);
  EXPECT_EQ(ReadAny(folder / "rig").cameras[1].model, nullptr);
}

// As multical, Metashape and others name things differently.
TEST(RigFormats, BadInput) {
  struct Case {
    std::string format;
    std::string from;
    std::string to;
    std::vector<std::string> parts;
  };
  for (const Case& bad : std::vector<Case>{
           {"rig_config",
            "[0.5, 0.5, -0.5, 0.5]",
            "[1, 1, 1]",
            {"cameras[1].cam_from_rig_rotation", "3 numbers, not 4"}},
           {"rig_config",
            "[0.5, 0.5, -0.5, 0.5]",
            "[0, 0, 0, 0]",
            {"not a unit quaternion"}},
           {"rig_config",
            "\"cam_from_rig_translation\": [2, 3, -1],",
            "",
            {"cam_from_rig_translation is missing"}},
           {"rig_config",
            "\"OPENCV\"",
            "\"OPENCW\"",
            {"'OPENCW' is not a camera model of COLMAP"}},
           {"rig_config", "]}]", "]}, {\"cameras\": []}]", {"has 2 rigs"}},
           {"rig_config", "\"a/\"", "\"b/\"", {"both camera 'b'"}},
           {"transforms", "\"fl_x\": 1000", "\"fl_x\": -1000", {"frames[0]"}},
           {"transforms",
            "[0, 0, -1, 1]",
            "[0, 0, -2, 1]",
            {"frames[0].transform_matrix", "not a rotation"}},
           {"transforms",
            "\"p2\": 0.02",
            "\"p2\": 0.02, \"k4\": 1",
            {"frames[0].k4", "OPENCV_FISHEYE"}},
           {"transforms",
            "\"OPENCV\"",
            "\"EQUIRECTANGULAR\"",
            {"'EQUIRECTANGULAR' is not supported"}},
           {"transforms",
            "\"cx\": 320.5",
            "\"cx\": \"320.5\"",
            {"frames[0].cx is not a finite number"}},
           {"transforms", "\"w\": 640", "\"w\": 640.5", {"w is not an image"}},
           {"transforms",
            "\"frames\": [",
            "\"frames\": 5, \"x\": [",
            {"frames is not a list"}},
           {"metashape",
            "<cx>0.5</cx>",
            "<cx>O.5</cx>",
            {"calibration/cx", "'O.5'"}},
           {"metashape",
            "<b1>100</b1>",
            "<b2>3</b2>",
            {"calibration/b2", "is not 0"}},
           {"metashape", "<k1>0.1</k1>", "<k4>0.1</k4>", {"calibration/k4"}},
           {"metashape",
            "<transform>0 0 1 1 -1",
            "<transform>0 0 1 1 -2",
            {"camera 'a'/transform", "not a rotation"}},
           {"metashape",
            "<transform>0 0 1 1",
            "<transform>0 0 1",
            {"camera 'a'/transform has 15 numbers, not 16"}},
           {"metashape", "</chunk>", "</chunk><chunk/>", {"several chunks"}},
           {"metashape",
            "sensor_id=\"0\"",
            "sensor_id=\"5\"",
            {"sensor_id '5'"}},
           {"metashape",
            "</cameras>",
            "</camera>",
            {"cameras.xml:", "not valid XML"}},
           {"panoptic", "[1000, 0, 320]", "[1000, 3, 320]", {"no skew"}},
           {"panoptic",
            "[[2], [3], [-1]]",
            "[[2], [3]]",
            {"cameras[0].t has 2 numbers, not 3"}},
           {"panoptic",
            "[[0, -1, 0]",
            "[[0, 1, 0]",
            {"camera a", "not a rotation"}},
           {"panoptic",
            "[[2], [3], [-1]]",
            "[[2], [3], [NaN]]",
            {"not valid JSON", "line 5"}},
           {"multical",
            "\"a_to_b\": {",
            "\"b\": {",
            {"the key 'b' stands twice"}},
           {"kalibr", "cam1:", "cam0:", {"cam0 stands twice"}},
           {"kalibr", "cam1:", "cam2:", {"cam1 is missing"}},
           {"csv", "px,py", "px,pz", {":1: the column py is missing"}},
           {"csv", "a,640", "a,640,640", {":2: there are 14 fields"}},
           {"csv", "1.5625", "1.5625x", {":2: fx '1.5625x'"}},
           {"csv", "b,640", "b,0", {":3: w is not an image size"}},
           {"csv", "b,640", "a,640", {"both camera 'a'"}},
           {"kalibr",
            "  - [0.0, 0.0, -1.0, 3.0]\n",
            "",
            {"cam1.T_cn_cnm1 has 12 numbers"}},
           {"kalibr",
            "camera_model: pinhole\n  distortion_coeffs: [0.1",
            "camera_model: omni\n  distortion_coeffs: [0.1",
            {"cam1.camera_model 'omni'"}},
           {"kalibr",
            "[0.1, 0.0, 0.01, 0.02]",
            "[0.1, 0.0, 0.01, x]",
            {"cam1.distortion_coeffs", "element 4"}},
           {"kalibr",
            "  rostopic: /b/image_raw\n",
            "  - x: [\n",
            {"camchain.yaml:", "not valid YAML"}},
           {"multical", "\"a_to_b\"", "\"a_to_c\"", {}},
           {"multical",
            "\"T\": [2, 3, -1]",
            "\"T\": [2, 3]",
            {"camera_poses.a_to_b.T has 2 numbers, not 3"}},
           {"multical",
            "[[0.1, 0, 0.01, 0.02, 0]]",
            "[[0.1, 0, 0, 0, 0, 0, 0, 0, 1]]",
            {"cameras.a", "beyond"}}}) {
    const TemporaryFolder folder;
    for (RigExample example : RigExamples()) {
      if (example.format != bad.format) continue;
      SCOPED_TRACE(bad.format + ": " + bad.to);
      std::string& content = example.files.front().second;
      content = Replaced(content, bad.from, bad.to);
      const std::string path = example.Write(folder.Path());
      if (bad.parts.empty()) {
        // Not an error: the camera without pose is left out, and it is said.
        const Rig rig = ReadAny(path, bad.format);
        EXPECT_EQ(rig.cameras.size(), 1);
        EXPECT_EQ(rig.remarks.size(), 1);
      } else {
        ExpectInputError([&]() { ReadAny(path, bad.format); }, bad.parts);
      }
    }
  }
}

TEST(RigFormats, NotARig) {
  const TemporaryFolder folder;
  ExpectInputError([&]() { ReadAny(folder / "none"); },
                   {"no such file or folder", "camchain.yaml"});
  ExpectInputError([&]() { ReadAny(folder.Path()); },
                   {"not a known rig format"});
  WriteFile(folder / "a.json", "{\"x\": 1}");
  ExpectInputError([&]() { ReadAny(folder / "a.json"); },
                   {"not a known rig format"});
  WriteFile(folder / "b.json", "{\"frames\": [");
  ExpectInputError([&]() { ReadAny(folder / "b.json"); }, {"not valid JSON"});
  EXPECT_THROW(ReadAny(folder / "a.json", "bundler"), UsageError);
}

// The world of a georeferenced chunk: x_world = 2 Rz(90 deg) x + (10, 20, 30).
TEST(RigFormats, MetashapeChunkTransform) {
  const TemporaryFolder folder;
  for (RigExample example : RigExamples()) {
    if (example.format != "metashape") continue;
    std::string& content = example.files.front().second;
    content = Replaced(content,
                       "    <cameras next_id",
                       "<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation>"
                       "<translation>10 20 30</translation><scale>2</scale>"
                       "</transform>\n    <cameras next_id");
    const Rig rig = ReadAny(example.Write(folder.Path()));
    // 2 * (-2, 1, 3) + (10, 20, 30)
    EXPECT_LT(
        (Find(rig, "a").cam_from_world.Center() - Eigen::Vector3d(6, 22, 36))
            .norm(),
        1e-12);
    // (11, 1, 5) lies at 2 * (-1, 11, 5) + (10, 20, 30) then.
    EXPECT_LT((Project(Find(rig, "a"), Eigen::Vector3d(8, 42, 40)) -
               Eigen::Vector2d(422.0, 60.05))
                  .norm(),
              1e-9);
    EXPECT_EQ(rig.remarks.size(), 2);
  }
}

TEST(RigFormats, TransformsOfInstantNgp) {
  const TemporaryFolder folder;
  WriteFile(folder / "transforms.json",
            R"({"camera_angle_x": 1.5707963267948966, "w": 640, "h": 480,
                "is_fisheye": true, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4,
                "frames": [{"file_path": "a", "transform_matrix":
                [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]}]})");
  const Rig rig = ReadAny(folder / "transforms.json");
  EXPECT_EQ(rig.cameras[0].model, FindCameraModel("OPENCV_FISHEYE"));
  const std::vector<double> expected = {320, 320, 320, 240, 0.1, 0.2, 0.3, 0.4};
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(rig.cameras[0].params[i], expected[i], 1e-9);
  }
}

// A calibration capture: many frames of the same cameras.
TEST(RigFormats, ManyImagesPerCamera) {
  const std::string cameras =
      "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 501 501 320 240\n";
  const auto images = [](const std::vector<std::string>& names,
                         const std::string& x_of_last) {
    std::string text;
    for (size_t i = 0; i < names.size(); ++i) {
      const bool is_first = i < names.size() / 2;
      text += std::to_string(i + 1) + " 1 0 0 0 " +
              (is_first                ? "0"
               : i + 1 == names.size() ? x_of_last
                                       : "2") +
              " 0 0 " + (is_first ? "1 " : "2 ") + names[i] + "\n\n";
    }
    return text;
  };
  for (const std::vector<std::string>& names :
       {std::vector<std::string>{
            "0/c1.png", "1/c1.png", "0/c2.png", "1/c2.png"},
        {"c1/0.png", "c1/1.png", "c2/0.png", "c2/1.png"},
        {"rig/c1/0.png", "rig/c1/1.png", "rig/c2/0.png", "rig/c2/1.png"},
        {"c1_0.png", "c1_1.png", "c2_0.png", "c2_1.png"},
        {"0_c1.png", "1_c1.png", "0_c2.png", "1_c2.png"}}) {
    SCOPED_TRACE(names[0]);
    const TemporaryFolder folder;
    WriteFile(folder / "cameras.txt", cameras);
    WriteFile(folder / "images.txt", images(names, "2"));
    const Rig rig = ReadAny(folder.Path());
    ASSERT_EQ(rig.cameras.size(), 2);
    EXPECT_EQ(rig.cameras[0].name, "c1");
    EXPECT_EQ(rig.cameras[1].name, "c2");
    EXPECT_EQ(rig.cameras[1].params[0], 501.0);
    ASSERT_EQ(rig.remarks.size(), 1);
    EXPECT_NE(rig.remarks[0].find("4 images of 2 cameras"), std::string::npos);
  }
  // 1e-6 of the size of the rig are tolerated, more is not.
  const TemporaryFolder folder;
  const std::vector<std::string> names = {
      "0/c1.png", "1/c1.png", "0/c2.png", "1/c2.png"};
  WriteFile(folder / "cameras.txt", cameras);
  WriteFile(folder / "images.txt", images(names, "2.000001"));
  EXPECT_EQ(ReadAny(folder.Path()).cameras.size(), 2);
  WriteFile(folder / "images.txt", images(names, "2.00001"));
  ExpectInputError([&]() { ReadAny(folder.Path()); },
                   {"'0/c2.png' and '1/c2.png' are both camera 'c2'",
                    "poses differ by 0 rad"});
}

}  // namespace
}  // namespace mfir
