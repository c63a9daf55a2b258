// Plain arrays the refiner works on: a rig of fixed cameras and, per frame, the
// images, points and tracks of one instant.

#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <string>
#include <vector>

#include "camera_model.h"

namespace mfir {

// x_cam = rotation * x_world + translation.
struct Rigid3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d Center() const {
    return -(rotation.conjugate() * translation);
  }
  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const {
    return rotation * x + translation;
  }
};

// x_target = scale * rotation * x_source + translation.
struct Similarity3 {
  double scale = 1.0;
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const {
    return scale * (rotation * x) + translation;
  }
};

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
};

struct Observation {
  size_t image_idx = 0;                          // into Frame::images
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  // pixels
};

// One instant. The track of points[i] is
// observations[track_begins[i]] ... observations[track_begins[i + 1] - 1].
struct Frame {
  std::string name;
  std::vector<FrameImage> images;
  std::vector<Eigen::Vector3d> points;
  std::vector<size_t> track_begins = {0};
  std::vector<Observation> observations;
};

struct Scene {
  std::vector<RigCamera> cameras;
  std::vector<Frame> frames;
};

}  // namespace mfir
