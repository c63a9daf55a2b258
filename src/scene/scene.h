// Plain arrays the refiner works on: a rig of fixed cameras and, per frame, the
// images, points and tracks of one instant.

#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "src/geometry/rigid3.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// A physical camera: bolted in place, one set of intrinsics for all frames.
struct RigCamera {
  std::string name;
  // World = the rig's coordinates. Known, or corrected where the extrinsics are
  // known with a standard deviation only.
  Rigid3 cam_from_world;
  Rigid3 known_cam_from_world;
  // Lens; null while no image of the camera has been seen.
  const CameraModel* model = nullptr;
  size_t width = 0;
  size_t height = 0;
  std::vector<double> params;
  // What priors on the intrinsics pull to.
  std::vector<double> prior_params;
  // Whether the intrinsics stay at their start.
  bool constant_intrinsics = false;
};

// One image of a frame.
struct FrameImage {
  size_t camera_idx = 0;  // into Scene::cameras
  Rigid3 cam_from_world;  // estimated; world = the frame's coordinates
  std::vector<double> params;
  std::string name = {};  // in the model of the frame
};

// Of an observation that its image has no keypoint for.
constexpr uint32_t kNoKeypoint = UINT32_MAX;

struct Observation {
  size_t image_idx = 0;                          // into Frame::images
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  // pixels
  // Among the image's keypoints, or kNoKeypoint: has no dense feature then.
  uint32_t keypoint_idx = 0;
  // Into Frame::cost_maps; -1: without dense feature.
  int64_t cost_map_idx = -1;
};

// Cost maps of a frame (cost_maps.h), in fp16.
struct CostMaps {
  // Image coordinates of the centre of element (0, 0), and image pixels from
  // one element to the next.
  struct Placement {
    Eigen::Vector2d origin;
    double pixel_size;
  };

  int patch_size = 0;  // elements along each side
  std::vector<Placement> placements;
  // Element [((i * patch_size + row) * patch_size + column) * 3 + k] of map i:
  // k = 0: distance of the feature from the track's reference feature, k = 1,
  // 2: its derivatives by the image coordinates x and y (1/px).
  std::vector<uint16_t> data;

  const uint16_t* Data(size_t idx) const {
    return data.data() + idx * patch_size * patch_size * 3;
  }
};

// Where the reference feature of the track lies in the image, and the square
// root of its information relative to a typical feature: whitening * (x - xy)
// has the same standard deviation, in pixels, for every feature along each axis
// that has any weight. Zero: no feature.
struct FeatureKeypoint {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  // pixels
  Eigen::Matrix2d whitening = Eigen::Matrix2d::Zero();
};

// One instant. The track of points[i] is
// observations[track_begins[i]] ... observations[track_begins[i + 1] - 1].
struct Frame {
  std::string name;
  std::vector<FrameImage> images;
  std::vector<Eigen::Vector3d> points;
  std::vector<size_t> track_begins = {0};
  std::vector<Observation> observations;
  // Null without dense features. Shared, since frames are copied.
  std::shared_ptr<const CostMaps> cost_maps;
  // By index of the cost map; empty without.
  std::vector<FeatureKeypoint> feature_keypoints;
};

// The track of a point.
struct TrackIndex {
  size_t frame_idx = 0;
  size_t point_idx = 0;

  bool operator<(const TrackIndex& other) const {
    return std::tie(frame_idx, point_idx) <
           std::tie(other.frame_idx, other.point_idx);
  }
};

struct Scene {
  std::vector<RigCamera> cameras;
  std::vector<Frame> frames;
};

}  // namespace mfir
