// What the result must not depend on, and how near to the truth it is.

#include <random>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/models/camera_models.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

class InvarianceTest : public RefinerTest {
 protected:
  static constexpr double kMaxDifference = 1e-6;

  // Simulates into `name`/, refines into `name`/out, and returns the truth.
  CameraParams SimulateAndRefine(const SimulatorOptions& options,
                                 const std::string& name,
                                 CommandOptions more = {}) const {
    const SimulatedCapture capture = SimulateCapture(options);
    WriteSimulatedCapture(capture, Path(name));
    more["input_path"] = Path(name + "/frames");
    more["extrinsics_path"] = Path(name + "/rig");
    more["output_path"] = Path(name + "/out");
    ExpectRefines(more);
    return TrueParams(capture);
  }
};

TEST_F(InvarianceTest, UnitOfTheWorld) {
  ExpectRefines();
  const CameraParams expected = Params();
  const auto to_millimetres = [](host::Reconstruction* model) {
    Similarity3 scaled;
    scaled.scale = 1000.0;
    host::TransformReconstruction(scaled, model);
  };
  ChangeFrames(to_millimetres);
  host::Reconstruction rig = Read(Path("rig"));
  to_millimetres(&rig);
  WriteText(rig, Path("rig"));
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), kMaxDifference);
}

// The last digit of a keypoint must not decide on anything: the simulator's
// millimetres round elsewhere than its metres.
TEST_F(InvarianceTest, LastDigitsOfKeypoints) {
  ExpectRefines();
  const CameraParams expected = Params();
  ChangeFrames([](host::Reconstruction* model) {
    for (const auto& id_and_image : model->Images()) {
      host::Image& image = model->Image(id_and_image.first);
      for (host::point2D_t i = 0; i < image.NumPoints2D(); ++i) {
        host::SetXy(host::Xy(image.Point2D(i)) * (1.0 + 1e-14),
                    &image.Point2D(i));
      }
    }
  });
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), kMaxDifference);
}

// Rig in millimetres and elsewhere, frames as they are.
TEST_F(InvarianceTest, CoordinatesOfTheRig) {
  ExpectRefines();
  const CameraParams expected = Params();
  host::Reconstruction rig = Read(Path("rig"));
  Similarity3 moved;
  moved.scale = 1000.0;
  moved.rotation = Eigen::Quaterniond(0.2, -0.5, 0.7, 0.4).normalized();
  moved.translation = Eigen::Vector3d(5000, -200, 80);
  host::TransformReconstruction(moved, &rig);
  WriteText(rig, Path("rig"));
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), kMaxDifference);
}

TEST_F(InvarianceTest, GaugesOfTheFrames) {
  ExpectRefines();
  const CameraParams expected = Params();
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  ChangeFrames([&](host::Reconstruction* model) {
    Similarity3 gauge;
    gauge.scale = std::exp(5.0 * normal(random));
    gauge.rotation =
        Eigen::Quaterniond(normal(random), normal(random), normal(random), 1.0)
            .normalized();
    gauge.translation =
        100.0 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    host::TransformReconstruction(gauge, model);
  });
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), kMaxDifference);
}

TEST_F(InvarianceTest, NumberOfThreads) {
  ExpectRefines({{"MultiFrame.num_threads", "1"}});
  const auto expected = Files("out/rig");
  for (const char* num_threads : {"2", "3", "-1"}) {
    ExpectRefines({{"MultiFrame.num_threads", num_threads}});
    EXPECT_TRUE(expected == Files("out/rig")) << num_threads;
  }
}

// Image, camera and point ids in another order.
TEST_F(InvarianceTest, OrderOfIds) {
  ExpectRefines();
  const CameraParams expected = Params();
  ChangeFrames([](host::Reconstruction* model) {
    host::Reconstruction reversed;
    const auto new_id = [](uint32_t id) { return 1000 - id; };
    for (const auto& [id, camera] : model->Cameras()) {
      host::AddCameraWithTrivialRig(host::MakeCamera(id * 7,
                                                     host::ModelId(camera),
                                                     host::Width(camera),
                                                     host::Height(camera),
                                                     host::Params(camera)),
                                    &reversed);
    }
    for (const auto& [id, image] : model->Images()) {
      host::Image new_image;
      new_image.SetImageId(new_id(id));
      new_image.SetCameraId(image.CameraId() * 7);
      new_image.SetName(image.Name());
      std::vector<Eigen::Vector2d> points;
      for (const auto& point : image.Points2D())
        points.push_back(host::Xy(point));
      new_image.SetPoints2D(points);
      host::AddImageWithTrivialFrame(
          new_image, host::CamFromWorld(image), &reversed);
    }
    std::vector<host::point3D_t> ids;
    for (const host::point3D_t id : model->Point3DIds()) ids.push_back(id);
    std::sort(ids.rbegin(), ids.rend());
    for (const host::point3D_t id : ids) {
      host::Track track;
      auto elements = host::TrackOf(model->Point3D(id)).Elements();
      std::reverse(elements.begin(), elements.end());
      for (const auto& element : elements) {
        track.AddElement(new_id(element.image_id), element.point2D_idx);
      }
      reversed.AddPoint3D(host::Xyz(model->Point3D(id)), track);
    }
    *model = reversed;
  });
  ChangeRig([](host::Reconstruction* rig) {
    host::Reconstruction reversed;
    for (const auto& [id, camera] : rig->Cameras()) {
      host::AddCameraWithTrivialRig(camera, &reversed);
    }
    for (const auto& [id, image] : rig->Images()) {
      host::Image new_image;
      new_image.SetImageId(9 - id);
      new_image.SetCameraId(image.CameraId());
      new_image.SetName(image.Name());
      host::AddImageWithTrivialFrame(
          new_image, host::CamFromWorld(image), &reversed);
    }
    *rig = reversed;
  });
  ExpectRefines();
  EXPECT_LT(MaxRelativeDifference(expected, Params()), 1e-9);
}

TEST_F(InvarianceTest, GroundTruthHasNoInfluence) {
  ExpectRefines();
  const auto expected = Files("out/rig");
  ExpectRefines({{"ground_truth_path", Path("ground_truth")}});
  EXPECT_TRUE(expected == Files("out/rig"));
  EXPECT_TRUE(Summary().contains("evaluation"));
}

// 20 % of the poses of each frame are wrong.
TEST_F(InvarianceTest, WrongPoses) {
  SimulatorOptions options = SmallCapture();
  options.num_cameras = 10;
  SimulateAndRefine(options, "right");
  fs::copy(Path("right"), Path("wrong"), fs::copy_options::recursive);
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  for (int f = 0; f < 3; ++f) {
    const std::string path =
        Path("wrong/frames/frame00000" + std::to_string(f) + "/sparse/0");
    host::Reconstruction model = Read(path);
    for (const int i : {1 + 3 * f, 2 + 3 * f}) {
      Eigen::Vector4d qvec;
      Eigen::Vector3d tvec;
      for (int k = 0; k < 4; ++k) qvec(k) = normal(random);
      for (int k = 0; k < 3; ++k) tvec(k) = normal(random);
      SetPose(i, qvec.normalized(), tvec, &model);
    }
    WriteBinary(model, path);
  }
  ExpectRefines({{"input_path", Path("wrong/frames")},
                 {"extrinsics_path", Path("wrong/rig")},
                 {"output_path", Path("wrong/out")}});
  EXPECT_LT(MaxErrorInStds(Params("wrong/out"),
                           Params("right/out", "params_std"),
                           Params("right/out")),
            0.5);
}

TEST_F(InvarianceTest, EveryCameraModelIsRecovered) {
  SimulatorOptions options = SmallCapture();
  options.num_frames = 2;
  options.num_points = 400;
  options.focal_length = 700.0;  // wide enough to see distortion
  options.distance = 0.45;
  for (const CameraModel* model : AllCameraModels()) {
    SCOPED_TRACE(model->Name());
    options.camera_model = model->Name();
    // So many coefficients are not determined by so few points.
    if (model->NumParams() > 8) continue;
    const CameraParams truth = SimulateAndRefine(
        options, model->Name(), {{"MultiFrame.max_num_iterations", "500"}});
    const nlohmann::json summary = Summary(model->Name() + "/out");
    ASSERT_EQ(summary["cameras"].size(), truth.size());
    for (const nlohmann::json& camera : summary["cameras"]) {
      const std::vector<double> params = camera["params"];
      // The user is told that distortion is not determined.
      const size_t num_checked =
          camera["flags"].empty()
              ? params.size()
              : params.size() - model->ExtraParamsIdxs().size();
      for (size_t i = 0; i < num_checked; ++i) {
        EXPECT_LT(std::abs(params[i] - truth.at(camera["name"])[i]),
                  4.5 * camera["params_std"][i].get<double>())
            << camera["name"] << " parameter " << i;
      }
    }
  }
}

// Over many captures the errors are those that params_std promises.
TEST_F(InvarianceTest, StandardDeviationsAreHonest) {
  SimulatorOptions options = SmallCapture();
  double sum = 0.0;
  size_t count = 0;
  for (options.seed = 1; options.seed <= 10; ++options.seed) {
    const std::string name = "seed" + std::to_string(options.seed);
    const CameraParams truth = SimulateAndRefine(options, name);
    const CameraParams stds = Params(name + "/out", "params_std");
    for (const auto& [camera, params] : Params(name + "/out")) {
      for (size_t i = 0; i < params.size(); ++i) {
        const double error =
            (params[i] - truth.at(camera)[i]) / stds.at(camera)[i];
        sum += error * error;
        ++count;
      }
    }
  }
  const double rms = std::sqrt(sum / static_cast<double>(count));
  EXPECT_GT(rms, 0.5);
  EXPECT_LT(rms, 1.6);
}

TEST_F(InvarianceTest, NoNoiseGivesTheTruth) {
  SimulatorOptions options = SmallCapture();
  options.noise = 0.0;
  for (const double outlier_share : {0.0, 0.05}) {
    options.outlier_share = outlier_share;
    const std::string name = "exact" + std::to_string(outlier_share);
    const CameraParams truth = SimulateAndRefine(options, name);
    EXPECT_LT(MaxRelativeDifference(truth, Params(name + "/out")), 1e-4)
        << outlier_share;
  }
}

}  // namespace
}  // namespace mfir
