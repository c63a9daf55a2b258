// What may be written.

#include "colmap_ext/result/result_writer.h"

#include <limits>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"
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
    scene_.frames.emplace_back().name = "f1";
    FrameEstimate& frame = result_.refined.estimate.frames.emplace_back();
    frame.images = {{Rigid3(), camera.params}};
    frame.points = {Eigen::Vector3d(0, 0, 1)};
  }

  // Expects an error that names `what`.
  void ExpectError(const std::string& what) {
    try {
      CheckFinite(scene_, result_);
      ADD_FAILURE() << what;
    } catch (const Error& error) {
      EXPECT_EQ(error.exit_code, kExitSolver);
      EXPECT_NE(std::string(error.what()).find(what), std::string::npos)
          << error.what();
    }
  }

  FrameEstimate& Frame() { return result_.refined.estimate.frames[0]; }

  Scene scene_;
  RefinerResult result_;
};

TEST_F(CheckFiniteTest, AcceptsFiniteNumbers) {
  EXPECT_NO_THROW(CheckFinite(scene_, result_));
  // Of a camera without observations.
  result_.rms_px_after[0] = kNaN;
  EXPECT_NO_THROW(CheckFinite(scene_, result_));
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
  Frame().images[0].params[1] = kNaN;
  // Those of the rig are written.
  EXPECT_NO_THROW(CheckFinite(scene_, result_));
  result_.single_frame_mode = true;
  ExpectError("parameter of frame 'f1'");
}

TEST_F(CheckFiniteTest, PointOfAFrame) {
  Frame().points[0].y() = kNaN;
  ExpectError("point of frame 'f1'");
}

}  // namespace
}  // namespace mfir
