// What was measured: a rig of fixed cameras and, per frame, the images and
// tracks of one instant. Plain arrays, const once they are read; what is solved
// for is in estimate.h.

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
#include "src/parallel/communicator.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// A physical camera: bolted in place, one set of intrinsics for all frames.
struct RigCamera {
  std::string name;
  Rigid3 cam_from_world;  // world = the rig's coordinates
  // Lens; null while no image of the camera has been seen.
  const CameraModel* model = nullptr;
  size_t width = 0;
  size_t height = 0;
  std::vector<double> params;
  // Whether the intrinsics stay at their start.
  bool constant_intrinsics = false;
};

// One image of a frame.
struct FrameImage {
  size_t camera_idx = 0;  // into Scene::cameras
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

// One instant. The track of point i is
// observations[track_begins[i]] ... observations[track_begins[i + 1] - 1].
struct Frame {
  std::string name;
  std::vector<FrameImage> images;
  std::vector<size_t> track_begins = {0};
  std::vector<Observation> observations;
  // Null without dense features. Shared, since selections of tracks are copies.
  std::shared_ptr<const CostMaps> cost_maps;
  // By index of the cost map; empty without.
  std::vector<FeatureKeypoint> feature_keypoints;

  size_t NumPoints() const { return track_begins.size() - 1; }
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
  // The rig as it goes in: the known extrinsics, and the intrinsics that the
  // refinement starts from and that priors pull to.
  std::vector<RigCamera> cameras;
  std::vector<Frame> frames;
  // Who has the other frames of the capture, if any: sums and medians are those
  // of all frames.
  const Communicator* ranks = &Alone();
};

}  // namespace mfir
