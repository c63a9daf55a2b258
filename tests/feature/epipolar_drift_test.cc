#include "src/feature/epipolar_drift.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "src/geometry/epipolar_tolerance.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

struct Capture {
  std::vector<RigCamera> true_cameras;
  std::vector<RigCamera> drifted_cameras;
  std::vector<EpipolarMatch> matches;  // the right ones first
  size_t num_right = 0;
};

double FocalLength(const RigCamera& camera) {
  return camera.params[camera.model->FocalLengthIdxs()[0]];
}

// Points around the origin, seen by cameras on a dome; matches of all pairs
// with noise of half a pixel, `outlier_share` of them at random places.
Capture MakeCapture(const std::string& model, double outlier_share) {
  Random random({21});
  Capture capture;
  for (const Rigid3& pose : DomePoses(6, 4)) {
    RigCamera camera;
    camera.model = FindCameraModel(model);
    camera.width = kTestWidth;
    camera.height = kTestHeight;
    camera.params = TypicalParams(*camera.model);
    camera.cam_from_world = pose;
    capture.true_cameras.push_back(camera);
    const double factor = random.Normal(1.0, 0.02);
    for (const size_t idx : camera.model->FocalLengthIdxs()) {
      camera.params[idx] *= factor;
    }
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      camera.params[idx] += random.Normal(0.0, 10.0);
    }
    capture.drifted_cameras.push_back(camera);
  }
  const size_t num_cameras = capture.true_cameras.size();
  const auto keypoint = [&](size_t camera_idx, const Eigen::Vector3d& point) {
    const RigCamera& camera = capture.true_cameras[camera_idx];
    const Eigen::Vector2d uv = (camera.cam_from_world * point).hnormalized();
    Eigen::Vector2d xy;
    camera.model->Project(camera.params.data(), uv.x(), uv.y(), xy.data());
    return Eigen::Vector2d(
        xy + Eigen::Vector2d(random.Normal(0.0, 0.5), random.Normal(0.0, 0.5)));
  };
  std::vector<EpipolarMatch> outliers;
  for (size_t i = 0; i < num_cameras; ++i) {
    for (size_t j = i + 1; j < num_cameras; ++j) {
      for (int k = 0; k < 100; ++k) {
        const Eigen::Vector3d point = RandomVector(&random, 0.3);
        EpipolarMatch match{i, j, keypoint(i, point), keypoint(j, point)};
        if (random.Uniform() >= outlier_share) {
          capture.matches.push_back(match);
          continue;
        }
        match.xy2 = {random.Uniform(0.0, kTestWidth),
                     random.Uniform(0.0, kTestHeight)};
        outliers.push_back(match);
      }
    }
  }
  capture.num_right = capture.matches.size();
  capture.matches.insert(
      capture.matches.end(), outliers.begin(), outliers.end());
  return capture;
}

// Median over the right matches, pixels.
double MedianError(const Capture& capture,
                   const std::vector<PixelDrift>& drifts) {
  std::vector<double> errors;
  for (size_t i = 0; i < capture.num_right; ++i) {
    const EpipolarMatch& match = capture.matches[i];
    const RigCamera& camera1 = capture.drifted_cameras[match.camera_idx1];
    const RigCamera& camera2 = capture.drifted_cameras[match.camera_idx2];
    const auto ray =
        [&](const RigCamera& camera, size_t idx, const Eigen::Vector2d& xy) {
          const Eigen::Vector2d corrected = drifts[idx].Correct(camera, xy);
          Eigen::Vector2d uv;
          camera.model->Unproject(
              camera.params.data(), corrected.x(), corrected.y(), uv.data());
          return Eigen::Vector3d(uv.homogeneous().normalized());
        };
    errors.push_back(EpipolarError(
        EssentialMatrix(camera1.cam_from_world, camera2.cam_from_world),
        ray(camera1, match.camera_idx1, match.xy1),
        ray(camera2, match.camera_idx2, match.xy2),
        FocalLength(camera1),
        FocalLength(camera2)));
  }
  const auto middle = errors.begin() + errors.size() / 2;
  std::nth_element(errors.begin(), middle, errors.end());
  return *middle;
}

TEST(PixelDrift, MovesKeypointsAboutTheImageCenter) {
  RigCamera camera;
  camera.width = 800;
  camera.height = 600;
  PixelDrift drift;
  EXPECT_EQ(drift.Correct(camera, {1.0, 2.0}), Eigen::Vector2d(1.0, 2.0));
  drift.shift = {3.0, -2.0};
  drift.scale = 0.1;
  EXPECT_LT((drift.Correct(camera, {500.0, 300.0}) -
             Eigen::Vector2d(500.0 + 3.0 + 10.0, 300.0 - 2.0))
                .norm(),
            1e-12);
  // Half the diagonal is 500 pixels: r = 0.2 there.
  drift.radial = 0.5;
  EXPECT_LT(
      (drift.Correct(camera, {500.0, 300.0}) -
       Eigen::Vector2d(500.0 + 3.0 + 10.0 + 100.0 * 0.5 * 0.04, 300.0 - 2.0))
          .norm(),
      1e-12);
}

TEST(EstimateEpipolarDrift, BringsMatchesToTheirLines) {
  for (const char* model : {"PINHOLE", "OPENCV", "OPENCV_FISHEYE"}) {
    for (const double outlier_share : {0.0, 0.3}) {
      const Capture capture = MakeCapture(model, outlier_share);
      const std::vector<PixelDrift> none(capture.true_cameras.size());
      EXPECT_GT(MedianError(capture, none), 4.0) << model;
      // Noise alone: 0.67 * 0.5 px.
      EXPECT_LT(MedianError(capture,
                            EstimateEpipolarDrift(capture.drifted_cameras,
                                                  capture.matches)),
                0.45)
          << model << ", outliers " << outlier_share;
    }
  }
}

TEST(EstimateEpipolarDrift, NothingIsKnownWithoutMatches) {
  const Capture capture = MakeCapture("PINHOLE", 0.0);
  for (const PixelDrift& drift :
       EstimateEpipolarDrift(capture.drifted_cameras, {})) {
    EXPECT_EQ(drift.shift, Eigen::Vector2d(0.0, 0.0));
    EXPECT_EQ(drift.scale, 0.0);
    EXPECT_EQ(drift.radial, 0.0);
  }
  // Of the last camera nothing is known.
  std::vector<EpipolarMatch> matches;
  for (const EpipolarMatch& match : capture.matches) {
    if (match.camera_idx2 != 5) matches.push_back(match);
  }
  const PixelDrift last =
      EstimateEpipolarDrift(capture.drifted_cameras, matches)[5];
  EXPECT_EQ(last.shift, Eigen::Vector2d(0.0, 0.0));
}

TEST(EstimateEpipolarDrift, MatchesWithoutRaysHaveNoEffect) {
  Capture capture = MakeCapture("PINHOLE", 0.0);
  const std::vector<PixelDrift> expected =
      EstimateEpipolarDrift(capture.drifted_cameras, capture.matches);
  capture.matches.push_back({0, 1, {std::nan(""), 0.0}, {10.0, 10.0}});
  const std::vector<PixelDrift> drifts =
      EstimateEpipolarDrift(capture.drifted_cameras, capture.matches);
  for (size_t i = 0; i < drifts.size(); ++i) {
    EXPECT_EQ(drifts[i].shift, expected[i].shift);
    EXPECT_EQ(drifts[i].scale, expected[i].scale);
  }
}

}  // namespace
}  // namespace mfir
