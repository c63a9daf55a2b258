// What may be written.

#include "colmap_ext/exe/result_writer.h"

#include <limits>

#include <gtest/gtest.h>

#include "colmap_ext/io/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// A result with one camera that saw one point in one frame.
class CheckFiniteTest : public testing::Test {
 protected:
  void SetUp() override {
    KnownCamera camera;
    camera.name = "7";
    camera.model = FindCameraModel("PINHOLE");
    camera.params = {500, 500, 320, 240};
    result_.cameras = {camera};
    result_.rms_px_after = {0.5, 0.5};
    FrameModel& frame = capture_.frames.emplace_back();
    frame.name = "f1";
    frame.reconstruction = std::make_unique<colmap::Reconstruction>();
    colmap::Camera colmap_camera;
    colmap_camera.SetCameraId(1);
    colmap_camera.SetModelIdFromName("PINHOLE");
    colmap_camera.SetParams(camera.params);
    frame.reconstruction->AddCamera(colmap_camera);
    colmap::Image image;
    image.SetImageId(1);
    image.SetCameraId(1);
    image.SetTvec(Eigen::Vector3d(0, 0, 1));
    frame.reconstruction->AddImage(image);
    frame.reconstruction->AddPoint3D(Eigen::Vector3d(0, 0, 1), {});
    // A frame that is left out has no reconstruction.
    capture_.frames.emplace_back().skip_reason = "none";
    result_.capture = &capture_;
  }

  // Expects an error that names `what`.
  void ExpectError(const std::string& what) {
    try {
      CheckFinite(result_);
      ADD_FAILURE() << what;
    } catch (const Error& error) {
      EXPECT_EQ(error.exit_code, kExitSolver);
      EXPECT_NE(std::string(error.what()).find(what), std::string::npos)
          << error.what();
    }
  }

  colmap::Reconstruction& Model() { return *capture_.frames[0].reconstruction; }

  Capture capture_;
  RefinerResult result_;
};

TEST_F(CheckFiniteTest, AcceptsFiniteNumbers) {
  EXPECT_NO_THROW(CheckFinite(result_));
  // Of a camera without observations.
  result_.rms_px_after[0] = kNaN;
  EXPECT_NO_THROW(CheckFinite(result_));
}

TEST_F(CheckFiniteTest, IntrinsicsOfTheRig) {
  result_.cameras[0].params[3] = kNaN;
  ExpectError("parameter of camera '7'");
}

TEST_F(CheckFiniteTest, PoseOfTheRig) {
  result_.cameras[0].cam_from_world.translation.y() = kNaN;
  ExpectError("pose of camera '7'");
}

TEST_F(CheckFiniteTest, Rms) {
  result_.rms_px_after[1] = std::numeric_limits<double>::infinity();
  ExpectError("rms");
}

TEST_F(CheckFiniteTest, IntrinsicsOfAFrame) {
  Model().Camera(1).SetParams({500, kNaN, 0, 0});
  ExpectError("parameter of frame 'f1'");
}

TEST_F(CheckFiniteTest, PoseOfAFrame) {
  Model().Image(1).SetTvec(Eigen::Vector3d(0, kNaN, 0));
  ExpectError("pose of frame 'f1'");
}

TEST_F(CheckFiniteTest, PointOfAFrame) {
  Model().Point3D(1).SetXYZ(Eigen::Vector3d(kNaN, 0, 0));
  ExpectError("point of frame 'f1'");
}

}  // namespace
}  // namespace mfir
