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
    frame.reconstruction = std::make_unique<host::Reconstruction>();
    host::AddCameraWithTrivialRig(
        host::MakeCamera(
            1, CameraModelId(*camera.model), 640, 480, camera.params),
        frame.reconstruction.get());
    host::Image image;
    image.SetImageId(1);
    image.SetCameraId(1);
    Rigid3 pose;
    pose.translation.z() = 1.0;
    host::AddImageWithTrivialFrame(image, pose, frame.reconstruction.get());
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

  host::Reconstruction& Model() { return *capture_.frames[0].reconstruction; }

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
  host::SetParams({500, kNaN, 0, 0}, &Model().Camera(1));
  ExpectError("parameter of frame 'f1'");
}

TEST_F(CheckFiniteTest, PoseOfAFrame) {
  Rigid3 pose;
  pose.translation.y() = kNaN;
  host::SetCamFromWorld(pose, &Model().Image(1));
  ExpectError("pose of frame 'f1'");
}

TEST_F(CheckFiniteTest, PointOfAFrame) {
  host::Xyz(&Model().Point3D(1)) = Eigen::Vector3d(kNaN, 0, 0);
  ExpectError("point of frame 'f1'");
}

}  // namespace
}  // namespace mfir
