// The same two cameras in every rig format, written by hand from the
// conventions in docs/rig_formats.md.
//
// Camera a at (1, 2, 3) looks along the world's x axis, its y axis (down) is
// the world's -z: R = [0 -1 0; 0 0 -1; 1 0 0], t = -R (1, 2, 3) = (2, 3, -1),
// as quaternion (w, x, y, z) = (0.5, 0.5, -0.5, 0.5). fx = 1000, fy = 900,
// principal point (320.5, 240.5) in COLMAP pixels, k1 = 0.1, p1 = 0.01,
// p2 = 0.02. Camera b: identity, fx = fy = 500, (320, 240), no distortion.
//
// The point (11, 1, 5): in a (1, -2, 10), so u = 0.1, v = -0.2, r^2 = 0.05,
//   u' = 0.1 * 1.005 + 2 * 0.01 * (-0.02) + 0.02 * (0.05 + 0.02) = 0.1015,
//   v' = -0.2 * 1.005 + 0.01 * (0.05 + 0.08) + 2 * 0.02 * (-0.02) = -0.2005,
// so x = 422.0, y = 60.05; without distortion 420.5, 60.5. In b x = 1420,
// y = 340.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include "tests/support/test_files.h"

namespace mfir {

struct RigExample {
  std::string format;
  std::string path;                                        // within the folder
  std::vector<std::pair<std::string, std::string>> files;  // name, content
  bool has_distortion = true;
  bool has_size = true;

  // Writes the files to the folder and returns the path of the rig.
  std::string Write(const std::string& folder) const {
    for (const auto& [name, content] : files) {
      WriteFile(folder + "/" + name, content);
    }
    return path.empty() ? folder : folder + "/" + path;
  }
};

// numpy.savez_compressed of images, intrinsics (float64), trajectories
// (float32) and image_sizes (int64).
inline std::string NpzExample() {
  const std::string digits =
      "504b0304140000000800000021007dff46e955000000a80000000a001400696d616765"
      "732e6e707901001000a80000000000000055000000000000009bec17ea1b10c9c850c6"
      "50ad9e925a9c5ca46ea5a06e136aaaaea3a09e965f54529498179f5f94920a12774bcc"
      "294e058a17672416a402f91a463a9a3a0ab50a1400ae440606063d202e00e23c204e07"
      "e2242c6200504b03041400000008000000210066a161b36d000000100100000e001400"
      "696e7472696e736963732e6e70790100100010010000000000006d000000000000009b"
      "ec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a1aea3a09e965f5452949817"
      "9f5f94920a12774bcc294e058a17672416a402f91a463a0ac640a4a9a350ab401ee062"
      "0001877e0706145082ca57e881f2f3d0d4c1c0077b8839f5a8f23f8a51f930f90fb938"
      "cd0100504b030414000000080000002100cdd73d036100000000010000100014007472"
      "616a6563746f726965732e6e707901001000000100000000000061000000000000009b"
      "ec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a2aea3a09e965f5452949817"
      "9f5f94920a12774bcc294e058a17672416a402f91a463a0a2640a4a9a350ab401ee062"
      "8083067b28de8f10637080ca41c51c1c1850004c0f3a205e0c00504b03041400000008"
      "000000210026f830f650000000a00000000f001400696d6167655f73697a65732e6e70"
      "7901001000a00000000000000050000000000000009bec17ea1b10c9c850c650ad9e92"
      "5a9c5ca46ea5a06e9369a1aea3a09e965f54529498179f5f94920a12774bcc294e058a"
      "17672416a402f91a463a0a469a3a0ab50a6403ae0626063078c008a1d1f900504b0102"
      "1403140000000800000021007dff46e955000000a80000000a00000000000000000000"
      "00800100000000696d616765732e6e7079504b010214031400000008000000210066a1"
      "61b36d000000100100000e0000000000000000000000800191000000696e7472696e73"
      "6963732e6e7079504b0102140314000000080000002100cdd73d036100000000010000"
      "10000000000000000000000080013e0100007472616a6563746f726965732e6e707950"
      "4b010214031400000008000000210026f830f650000000a00000000f00000000000000"
      "000000008001e1010000696d6167655f73697a65732e6e7079504b0506000000000400"
      "0400ef000000720200000000";
  std::string bytes;
  for (size_t i = 0; i < digits.size(); i += 2) {
    bytes += static_cast<char>(std::stoi(digits.substr(i, 2), nullptr, 16));
  }
  return bytes;
}

inline const std::vector<RigExample>& RigExamples() {
  static const std::vector<RigExample> examples = {
      {"colmap",
       "",
       {{"cameras.txt",
         "# the cameras\n"
         "1 OPENCV 640 480 1000 900 320.5 240.5 0.1 0 0.01 0.02\n"
         "2 PINHOLE 640 480 500 500 320 240\n"},
        {"images.txt",
         "# the images\n"
         "1 0.5 0.5 -0.5 0.5 2 3 -1 1 a.png\n\n"
         "2 1 0 0 0 0 0 0 2 b.png\n\n"}}},
      {"rig_config",
       "rig_config.json",
       {{"rig_config.json",
         R"([{"cameras": [
  {"image_prefix": "b/", "ref_sensor": true,
   "camera_model_name": "PINHOLE", "camera_params": [500, 500, 320, 240]},
  {"image_prefix": "a/",
   "cam_from_rig_rotation": [0.5, 0.5, -0.5, 0.5],
   "cam_from_rig_translation": [2, 3, -1],
   "camera_model_name": "OPENCV",
   "camera_params": [1000, 900, 320.5, 240.5, 0.1, 0, 0.01, 0.02]}
]}]
)"}},
       true,
       false},
      {"krt",
       "KRT",
       {{"KRT",
         "a\n1000 0 320.5\n0 900 240.5\n0 0 1\n0.1 0 0.01 0.02 0\n"
         "0 -1 0 2\n0 0 -1 3\n1 0 0 -1\n\n"
         "b\n500 0 320\n0 500 240\n0 0 1\n0 0 0 0 0\n"
         "1 0 0 0\n0 1 0 0\n0 0 1 0\n"}},
       true,
       false},
      {"opencv",
       "",
       {{"intri.yml",
         "%YAML:1.0\n---\nnames:\n  - \"a\"\n  - \"b\"\n"
         "K_a: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
         "  data: [1000., 0., 320., 0., 900., 240., 0., 0., 1.]\n"
         "dist_a: !!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n"
         "  data: [0.1, 0., 0.01, 0.02, 0.]\n"
         "H_a: 480\nW_a: 640\n"
         "K_b: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
         "  data: [500., 0., 319.5, 0., 500., 239.5, 0., 0., 1.]\n"
         "dist_b: !!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n"
         "  data: [0., 0., 0., 0., 0.]\n"
         "H_b: 480\nW_b: 640\n"},
        {"extri.yml",
         "%YAML:1.0\n---\nnames:\n  - \"a\"\n  - \"b\"\n"
         "Rot_a: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
         "  data: [0., -1., 0., 0., 0., -1., 1., 0., 0.]\n"
         "T_a: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n"
         "  data: [2., 3., -1.]\n"
         "Rot_b: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
         "  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]\n"
         "T_b: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n"
         "  data: [0., 0., 0.]\n"}}},
      {"transforms",
       "transforms.json",
       // Columns of the matrices: x axis, up, backwards, centre.
       {{"transforms.json",
         R"({
  "w": 640, "h": 480, "camera_model": "OPENCV",
  "frames": [
    {"file_path": "./images/a.png",
     "fl_x": 1000, "fl_y": 900, "cx": 320.5, "cy": 240.5,
     "k1": 0.1, "k2": 0, "p1": 0.01, "p2": 0.02,
     "transform_matrix": [[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3],
                          [0, 0, 0, 1]]},
    {"file_path": "./images/b.png", "fl_x": 500,
     "transform_matrix": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0],
                          [0, 0, 0, 1]]}
  ]
}
)"}}},
      {"metashape",
       "cameras.xml",
       // P1 and P2 are OpenCV's p2 and p1; B1 = fx - fy; the principal point is
       // an offset from the middle.
       {{"cameras.xml",
         R"(<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="2">
      <sensor id="0" label="unknown" type="frame">
        <resolution width="640" height="480"/>
        <calibration type="frame" class="initial">
          <resolution width="640" height="480"/>
          <f>1</f>
        </calibration>
        <calibration type="frame" class="adjusted">
          <resolution width="640" height="480"/>
          <f>900</f>
          <cx>0.5</cx>
          <cy>0.5</cy>
          <b1>100</b1>
          <k1>0.1</k1>
          <p1>0.02</p1>
          <p2>0.01</p2>
        </calibration>
      </sensor>
      <sensor id="1" label="other" type="frame">
        <resolution width="640" height="480"/>
        <calibration type="frame" class="adjusted">
          <resolution width="640" height="480"/>
          <f>500</f>
        </calibration>
      </sensor>
    </sensors>
    <cameras next_id="3" next_group_id="1">
      <camera id="0" sensor_id="0" label="a" enabled="true">
        <transform>0 0 1 1 -1 0 0 2 0 -1 0 3 0 0 0 1</transform>
        <orientation>1</orientation>
      </camera>
      <group id="0" label="Group 1">
        <camera id="1" sensor_id="1" label="b" enabled="true">
          <transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>
        </camera>
      </group>
      <camera id="2" sensor_id="1" label="not aligned" enabled="true"/>
    </cameras>
  </chunk>
</document>
)"}}},
      {"panoptic",
       "calibration.json",
       {{"calibration.json",
         R"({"calibDataSource": "example", "cameras": [
  {"name": "a", "type": "hd", "resolution": [640, 480], "panel": 0, "node": 0,
   "K": [[1000, 0, 320], [0, 900, 240], [0, 0, 1]],
   "distCoef": [0.1, 0, 0.01, 0.02, 0],
   "R": [[0, -1, 0], [0, 0, -1], [1, 0, 0]], "t": [[2], [3], [-1]]},
  {"name": "b", "type": "hd", "resolution": [640, 480], "panel": 0, "node": 1,
   "K": [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]],
   "distCoef": [0, 0, 0, 0, 0],
   "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [[0], [0], [0]]}
]}
)"}}},
      {"csv",
       "calibration.csv",
       // The inverse rotation turns by 120 degrees about (-1, 1, -1).
       {{"calibration.csv",
         "name,w,h,rx,ry,rz,tx,ty,tz,fx,fy,px,py\n"
         "a,640,480,-1.2091995761561452,1.2091995761561452,"
         "-1.2091995761561452,1,2,3,1.5625,1.875,0.50078125,"
         "0.5010416666666667\n"
         "b,640,480,0,0,0,0,0,0,0.78125,1.0416666666666667,0.5,0.5\n"}},
       false},
      {"kalibr",
       "camchain.yaml",
       {{"camchain.yaml",
         "cam0:\n"
         "  cam_overlaps: [1]\n"
         "  camera_model: pinhole\n"
         "  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n"
         "  distortion_model: radtan\n"
         "  intrinsics: [500.0, 500.0, 319.5, 239.5]\n"
         "  resolution: [640, 480]\n"
         "  rostopic: /b/image_raw\n"
         "cam1:\n"
         "  T_cn_cnm1:\n"
         "  - [0.0, -1.0, 0.0, 2.0]\n"
         "  - [0.0, 0.0, -1.0, 3.0]\n"
         "  - [1.0, 0.0, 0.0, -1.0]\n"
         "  - [0.0, 0.0, 0.0, 1.0]\n"
         "  camera_model: pinhole\n"
         "  distortion_coeffs: [0.1, 0.0, 0.01, 0.02]\n"
         "  distortion_model: radtan\n"
         "  intrinsics: [1000.0, 900.0, 320.0, 240.0]\n"
         "  resolution: [640, 480]\n"
         "  rostopic: /a/image_raw\n"}}},
      {"multical",
       "calibration.json",
       {{"calibration.json",
         R"({
  "cameras": {
    "a": {"model": "standard", "image_size": [640, 480],
          "K": [[1000, 0, 320], [0, 900, 240], [0, 0, 1]],
          "dist": [[0.1, 0, 0.01, 0.02, 0]]},
    "b": {"model": "standard", "image_size": [640, 480],
          "K": [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]],
          "dist": [[0, 0, 0, 0, 0]]}
  },
  "camera_poses": {
    "b": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [0, 0, 0]},
    "a_to_b": {"R": [[0, -1, 0], [0, 0, -1], [1, 0, 0]], "T": [2, 3, -1]}
  }
}
)"}}},
      {"npz", "cameras.npz", {{"cameras.npz", NpzExample()}}, false}};
  return examples;
}

}  // namespace mfir
