// A camera whose pose in RIG is wrong: its intrinsics take the rotation up, and
// nothing but a comparison with the other cameras can tell.

#include "colmap_ext/host/reconstruction.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

class BumpedCameraTest : public RefinerTest {
 protected:
  // Turns a camera in RIG about its centre.
  void Bump(host::image_t image_id, double degrees) const {
    ChangeRig([&](host::Reconstruction* rig) {
      host::Image& image = rig->Image(image_id);
      Rigid3 pose = host::CamFromWorld(image);
      const Eigen::Vector3d center = pose.Center();
      pose.rotation = Eigen::AngleAxisd(degrees * M_PI / 180.0,
                                        Eigen::Vector3d(0.8, -0.6, 0.0)) *
                      pose.rotation;
      pose.translation = -(pose.rotation * center);
      host::SetCamFromWorld(pose, &image);
    });
  }

  static std::vector<std::string> WithFlag(const nlohmann::json& summary,
                                           const std::string& flag) {
    std::vector<std::string> names;
    for (const nlohmann::json& camera : summary["cameras"]) {
      for (const nlohmann::json& camera_flag : camera["flags"]) {
        if (camera_flag == flag) names.push_back(camera["name"]);
      }
    }
    return names;
  }
};

TEST_F(BumpedCameraTest, IsNamedWithItsChangeAndItsAngle) {
  Bump(3, 2.0);
  const CommandResult result = Refine({{"MultiFrame.quiet", "1"}});
  EXPECT_EQ(result.exit_code, kExitSuccess) << result.error;
  EXPECT_NE(result.error.find("WARNING: camera 'cam02' has changed unusually"),
            std::string::npos)
      << result.error;
  EXPECT_NE(result.error.find("WARNING: camera 'cam02' has moved"),
            std::string::npos)
      << result.error;
  const nlohmann::json summary = Summary();
  const std::vector<std::string> bumped = {"cam02"};
  EXPECT_EQ(WithFlag(summary, "unusual_drift"), bumped);
  EXPECT_EQ(WithFlag(summary, "moved"), bumped);
  for (const nlohmann::json& camera : summary["cameras"]) {
    const double principal_point_stds =
        camera["drift"]["from_start"]["principal_point_stds"];
    EXPECT_EQ(principal_point_stds > 7.0, camera["name"] == "cam02");
    if (camera["name"] == "cam02") {
      // Wrong intrinsics of the frames turn their poses, too.
      EXPECT_NEAR(camera["moved_deg"].get<double>(), 2.0, 0.5);
    } else {
      EXPECT_TRUE(camera["moved_deg"].is_null());
    }
  }
}

TEST_F(BumpedCameraTest, HealthyCapturesGiveNoAlarm) {
  const CommandResult result = Refine();
  EXPECT_EQ(result.exit_code, kExitSuccess);
  EXPECT_EQ(result.error.find("WARNING"), std::string::npos) << result.error;
}

}  // namespace
}  // namespace mfir
