// New tracks between the solves of the refiner, on a small rendered capture
// whose frames come from multi_frame_triangulator with wrong intrinsics.

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/sqlite_file.h"
#include "tests/support/refiner_runner.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

const char* const kFrame0 = "frame000000";
const char* const kFrame1 = "frame000001";

class RetriangulationTest : public RefinerTest {
 protected:
  static void SetUpTestSuite() {
    original_ = new TemporaryFolder;
    const std::string capture = *original_ / "capture";
    SimulatorOptions options = RenderedCapture();
    options.camera_model = "PINHOLE";
    WriteSimulatedCapture(SimulateCapture(options), capture);
    const CommandResult result = RunColmap({"multi_frame_triangulator",
                                            "--image_path",
                                            capture + "/images",
                                            "--extrinsics_path",
                                            capture + "/rig",
                                            "--output_path",
                                            capture + "/tracks",
                                            "--SiftExtraction.max_num_features",
                                            "500"},
                                           300);
    ASSERT_EQ(result.exit_code, 0) << result.error;
  }

  std::string Database(const std::string& frame) const {
    return Path("tracks/" + frame + "/database.db");
  }

  // Refines tracks/ into the folder `output`. Returns what was printed.
  std::string RefineTracks(const std::string& output,
                           CommandOptions options) const {
    options.emplace("input_path", Path("tracks"));
    options.emplace("ground_truth_path", Path("ground_truth"));
    options.emplace("output_path", Path(output));
    const CommandResult result = Refine(options, 300);
    EXPECT_EQ(result.exit_code, 0) << result.error;
    return result.output;
  }

  static CommandOptions Rounds(const std::string& number) {
    return {{"MultiFrame.retriangulation_rounds", number}};
  }

  // Of a frame of a result.
  size_t NumObservations(const std::string& output, size_t frame_idx) const {
    return Summary(output)["frames"][frame_idx]["num_observations"];
  }

  // The common focal scale is weak in so small a capture, and other errors are
  // random within a tenth of those at the start.
  void ExpectNoLargerErrors(const std::string& before,
                            const std::string& after) const {
    ASSERT_EQ(RunColmap({"multi_frame_evaluator",
                         "--input_path",
                         Path("rig"),
                         "--ground_truth_path",
                         Path("ground_truth"),
                         "--output_path",
                         Path("start.json")})
                  .exit_code,
              0);
    const auto start = nlohmann::json::parse(ReadFile(Path("start.json")));
    for (const char* error : {"focal_rel", "pp_abs"}) {
      const auto rest = [error](const nlohmann::json& evaluation) {
        return evaluation["rest"][error]["mean"].get<double>();
      };
      EXPECT_LT(rest(Summary(after)["evaluation"]),
                rest(Summary(before)["evaluation"]) + 0.1 * rest(start))
          << error;
      EXPECT_LT(rest(Summary(after)["evaluation"]), 0.4 * rest(start)) << error;
    }
  }

  std::string RefinedCameras(const std::string& output) const {
    return ReadFile(Path(output + "/rig/cameras.txt"));
  }
};

TEST_F(RetriangulationTest, MoreTracksAndNoLargerErrors) {
  const auto inputs = Files("tracks");
  RefineTracks("before", Rounds("0"));
  const std::string log = RefineTracks("after", {});  // 2 is the default
  EXPECT_NE(log.find("Round 1 / 2: new tracks in 2 of 2 frames"),
            std::string::npos)
      << log;
  EXPECT_TRUE(Files("tracks") == inputs);
  EXPECT_FALSE(fs::exists(Path("after/.unfinished")));

  const nlohmann::json before = Summary("before");
  const nlohmann::json after = Summary("after");
  for (const size_t i : {0, 1}) {
    EXPECT_GT(NumObservations("after", i), NumObservations("before", i));
    const host::Reconstruction model =
        Read(Path("after/frames/" + std::string(i == 0 ? kFrame0 : kFrame1)));
    EXPECT_EQ(model.ComputeNumObservations(), NumObservations("after", i));
    EXPECT_EQ(model.NumPoints3D(), after["frames"][i]["num_points"]);
    EXPECT_LT(model.ComputeMeanReprojectionError(), 1.0);
  }
  ExpectNoLargerErrors("before", "after");
  EXPECT_TRUE(after["result"]["held_out_rms_px"].is_number());
  // The start is that of the frames as given.
  EXPECT_EQ(Params("after", "params_initial"),
            Params("before", "params_initial"));
  EXPECT_GT(after["result"]["rms_px_before"],
            2.0 * after["result"]["rms_px_after"].get<double>());
}

TEST_F(RetriangulationTest, FramesWithoutDatabaseKeepTheirTracks) {
  RefineTracks("before", Rounds("0"));
  fs::remove(Database(kFrame1));
  RefineTracks("one", Rounds("1"));
  EXPECT_GT(NumObservations("one", 0), NumObservations("before", 0));
  EXPECT_EQ(NumObservations("one", 1), NumObservations("before", 1));
  fs::remove(Database(kFrame0));
  RefineTracks("none", {});
  EXPECT_EQ(RefinedCameras("none"), RefinedCameras("before"));
}

TEST_F(RetriangulationTest, DatabasesMayLieWithTheModel) {
  fs::rename(Database(kFrame0),
             Path("tracks/" + std::string(kFrame0) + "/sparse/database.db"));
  fs::rename(Database(kFrame1),
             Path("tracks/" + std::string(kFrame1) + "/sparse/0/database.db"));
  // A database beside the frames is none of theirs.
  WriteFile(Path("tracks/database.db"), "none");
  EXPECT_NE(RefineTracks("out", Rounds("1")).find("new tracks in 2 of 2"),
            std::string::npos);
}

TEST_F(RetriangulationTest, UnusableDatabasesLeaveTheTracks) {
  RefineTracks("before", Rounds("0"));
  WriteFile(Database(kFrame0), "SQLite format 3, or not");
  // Keypoints that are not those of the database.
  const std::string model_path =
      Path("tracks/" + std::string(kFrame1) + "/sparse/0");
  host::Reconstruction model = Read(model_path);
  for (const auto& [id, point] : model.Points3D()) {
    for (const auto& element : host::TrackOf(point).Elements()) {
      host::Point2D& keypoint =
          model.Image(element.image_id).Point2D(element.point2D_idx);
      host::SetXy(host::Xy(keypoint) + Eigen::Vector2d(0.1, 0.0), &keypoint);
    }
  }
  WriteBinary(model, model_path);
  const std::string log = RefineTracks("after", {});
  for (const char* part :
       {"Frame 'frame000000' keeps its tracks",
        "is no usable COLMAP database",
        "Frame 'frame000001' keeps its tracks",
        "keypoints of image 'cam00.png' are not those of the sparse model",
        "new tracks in 0 of 2 frames"}) {
    EXPECT_NE(log.find(part), std::string::npos) << part << "\n" << log;
  }
  RefineTracks("again", Rounds("0"));
  EXPECT_EQ(RefinedCameras("after"), RefinedCameras("again"));
  EXPECT_EQ(Summary("after")["result"], Summary("again")["result"]);
  for (const size_t i : {0, 1}) {
    EXPECT_EQ(NumObservations("after", i), NumObservations("before", i));
  }
}

TEST_F(RetriangulationTest, FewerThanHalfTheObservationsAreNoImprovement) {
  RefineTracks("before", Rounds("0"));
  SqliteFile(Database(kFrame0), SQLITE_OPEN_READWRITE)
      .Execute("DELETE FROM matches WHERE pair_id % 4 != 0");
  SqliteFile(Database(kFrame0), SQLITE_OPEN_READWRITE)
      .Execute("DELETE FROM descriptors");
  const std::string log = RefineTracks("after", Rounds("1"));
  EXPECT_NE(log.find("it gives only"), std::string::npos) << log;
  EXPECT_EQ(NumObservations("after", 0), NumObservations("before", 0));
  EXPECT_GT(NumObservations("after", 1), NumObservations("before", 1));
}

// As other extractors and matchers write them.
TEST_F(RetriangulationTest, DatabasesWithVerifiedMatchesOnly) {
  for (const char* frame : {kFrame0, kFrame1}) {
    for (const char* table : {"matches", "descriptors"}) {
      SqliteFile(Database(frame), SQLITE_OPEN_READWRITE)
          .Execute("DELETE FROM " + std::string(table));
    }
  }
  RefineTracks("before", Rounds("0"));
  const std::string log = RefineTracks("after", {});
  EXPECT_NE(log.find("Round 1 / 2: new tracks in 2 of 2 frames"),
            std::string::npos)
      << log;
  ExpectNoLargerErrors("before", "after");
}

TEST_F(RetriangulationTest, StopsWhereNewTracksAreNoImprovement) {
  const std::string log = RefineTracks("out", Rounds("8"));
  EXPECT_NE(log.find("No improvement: the tracks stay"), std::string::npos)
      << log;
  EXPECT_EQ(log.find("Round 5 / 8"), std::string::npos);
  // Nothing is solved after that.
  EXPECT_EQ(log.find("Solve", log.find("No improvement")), std::string::npos);
  EXPECT_GT(Summary()["result"]["noise_std_px"], 0.0);
}

// The same options of COLMAP as multi_frame_triangulator has.
TEST_F(RetriangulationTest, OptionsOfColmapReachTheTracks) {
  WriteFile(Path("project.ini"),
            "[Mapper]\nmultiple_models=0\nfilter_min_tri_angle=25\n"
            "[SiftMatching]\nconfidence=0.9\nguided_matching=0\n"
            "[FeatureMatching]\nguided_matching=0\n"  // its place in COLMAP 4
            "[MultiFrameTriangulator]\nmax_view_angle=50\n"
            "[SiftExtraction]\nmax_num_features=10\n");
  const auto smallest_angle_deg = [this](const std::string& output) {
    const host::Reconstruction model =
        Read(Path(output + "/frames/" + kFrame0));
    double smallest = 180.0;
    for (const auto& [id, point] : model.Points3D()) {
      double largest = 0.0;
      const auto ray = [&](const host::TrackElement& element) {
        return (model.Image(element.image_id).ProjectionCenter() -
                host::Xyz(point))
            .normalized();
      };
      for (const auto& a : host::TrackOf(point).Elements()) {
        for (const auto& b : host::TrackOf(point).Elements()) {
          largest =
              std::max(largest, std::acos(std::min(1.0, ray(a).dot(ray(b)))));
        }
      }
      smallest = std::min(smallest, host::RadToDeg(largest));
    }
    return smallest;
  };
  RefineTracks("default", Rounds("1"));
  CommandOptions options = Rounds("1");
  options["project_path"] = Path("project.ini");
  RefineTracks("ini", options);
  // Points move a little after they are filtered.
  EXPECT_GT(smallest_angle_deg("ini"), 24.0);
  EXPECT_LT(smallest_angle_deg("default"), 20.0);
  // The command line beats the ini file.
  options["Mapper.filter_min_tri_angle"] = "1.5";
  RefineTracks("both", options);
  EXPECT_LT(smallest_angle_deg("both"), 20.0);
  EXPECT_LT(NumObservations("both", 0), NumObservations("default", 0));
  EXPECT_EQ(Summary("both")["options"]["Mapper.filter_min_tri_angle"], 1.5);

  options["Mapper.filter_min_tri_angle"] = "-1";
  options["input_path"] = Path("tracks");
  ExpectError(kExitUsage, {"Mapper.filter_min_tri_angle"}, options);
}

TEST_F(RetriangulationTest, SameBytesForAnyNumberOfThreads) {
  RefineTracks("one", {});
  CommandOptions threads = {{"MultiFrame.num_threads", "3"}};
  RefineTracks("three", threads);
  EXPECT_EQ(RefinedCameras("one"), RefinedCameras("three"));
}

TEST_F(RetriangulationTest, SingleFramesHaveTracksByTheirOwnIntrinsics) {
  CommandOptions options = {
      {"MultiFrame.focal_variance_weight", "0"},
      {"MultiFrame.principal_point_variance_weight", "0"}};
  const std::string log = RefineTracks("after", options);
  EXPECT_NE(log.find("new tracks in 2 of 2"), std::string::npos) << log;
  options["MultiFrame.retriangulation_rounds"] = "0";
  RefineTracks("before", options);
  EXPECT_GT(NumObservations("after", 0), NumObservations("before", 0));
}

TEST_F(RetriangulationTest, StaticPointsAreFoundAmongNewTracks) {
  const std::string copy = Path("tracks/" + std::string(kFrame1));
  fs::remove_all(copy);
  fs::copy(Path("tracks/" + std::string(kFrame0)),
           copy,
           fs::copy_options::recursive);
  const std::string log =
      RefineTracks("both", {{"MultiFrame.static_points", "merge"}});
  EXPECT_NE(log.find("new tracks in 2 of 2"), std::string::npos) << log;
  EXPECT_EQ(Summary("both")["result"]["static_points"]["observation_share"],
            1.0);
  EXPECT_EQ(NumObservations("both", 0), NumObservations("both", 1));

  fs::remove_all(copy);
  RefineTracks("one", {});
  // Not the same: keypoints at the same place become one, too.
  double ratio = 0.0;
  const CameraParams stds = Params("one", "params_std");
  for (const auto& [name, values] : Params("both", "params_std")) {
    ratio += values[0] / stds.at(name)[0] / static_cast<double>(stds.size());
  }
  EXPECT_NEAR(ratio, 1.0, 0.15);  // 0.7 if they counted twice
}

TEST_F(RetriangulationTest, SchedulesKeepTheirTracks) {
  const CommandOptions paper = {{"MultiFrame.preset", "paper"},
                                {"MultiFrame.max_prior_weight", "0.01"}};
  EXPECT_EQ(RefineTracks("out", paper).find("new tracks"), std::string::npos);
  CommandOptions asked = paper;
  asked["input_path"] = Path("tracks");
  asked["MultiFrame.retriangulation_rounds"] = "1";
  ExpectError(kExitUsage, {"retriangulation_rounds must be 0"}, asked);
}

}  // namespace
}  // namespace mfir
