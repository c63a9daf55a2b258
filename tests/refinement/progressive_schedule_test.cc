#include "src/refinement/progressive_schedule.h"

#include <cmath>
#include <limits>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "src/geometry/alignment.h"
#include "src/util/errors.h"
#include "tests/support/test_features.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// Frames in the coordinates of the schedule, their variables in memory of their
// own, as COLMAP has them.
struct Blocks {
  struct Image {
    size_t camera_idx;
    Eigen::Vector4d qvec;
    Eigen::Vector3d tvec;
    std::vector<double> params;
  };
  std::vector<RigCamera> cameras;
  std::vector<std::vector<Image>> frames;
  std::vector<std::vector<Eigen::Vector3d>> points;
  Scene scene;
};

TestSceneOptions BlockOptions(const std::string& model) {
  TestSceneOptions options;
  options.model = model;
  options.num_cameras = 6;
  options.num_points = 60;
  options.noise = 0.3;
  options.track_length = 4;
  return options;
}

// Poses and points off by about 1 % of the array, intrinsics as in
// MakeTestScene; frame 1 lacks the last camera.
Blocks MakeBlocks(const std::string& model) {
  Blocks blocks;
  const SceneEstimate start = MakeTestScene(BlockOptions(model)).start;
  blocks.scene = start.scene;
  std::vector<Rigid3> poses;
  for (const RigCamera& camera : blocks.scene.cameras) {
    poses.push_back(camera.cam_from_world);
  }
  const Similarity3 normalized_from_rig = NormalizeRig(poses);
  for (RigCamera& camera : blocks.scene.cameras) {
    camera.cam_from_world =
        TransformPose(normalized_from_rig, camera.cam_from_world);
  }
  Random random({41});
  for (size_t f = 0; f < blocks.scene.frames.size(); ++f) {
    Frame& frame = blocks.scene.frames[f];
    if (f == 1) frame.images.pop_back();
    std::vector<Blocks::Image>& images = blocks.frames.emplace_back();
    for (size_t i = 0; i < frame.images.size(); ++i) {
      const size_t camera_idx = frame.images[i].camera_idx;
      Rigid3 pose = blocks.scene.cameras[camera_idx].cam_from_world;
      pose.rotation = Rotation(RandomVector(&random, 0.01)) * pose.rotation;
      pose.translation += RandomVector(&random, 10.0);
      const Eigen::Quaterniond& q = pose.rotation;
      images.push_back({camera_idx,
                        Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()),
                        pose.translation,
                        start.estimate.frames[f].images[i].params});
    }
    blocks.points.emplace_back();
    for (const Eigen::Vector3d& xyz : start.estimate.frames[f].points) {
      blocks.points.back().push_back(normalized_from_rig * xyz);
    }
  }
  blocks.cameras = blocks.scene.cameras;
  return blocks;
}

// Calls visit(camera_idx, image, point, xy) for the observations of a frame
// whose image exists; returns their number.
template <typename Visitor>
size_t VisitObservations(Blocks* blocks, size_t f, const Visitor& visit) {
  const Frame& frame = blocks->scene.frames[f];
  size_t count = 0;
  for (size_t i = 0; i < frame.NumPoints(); ++i) {
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      const Observation& observation = frame.observations[k];
      if (observation.image_idx >= blocks->frames[f].size()) continue;
      visit(&blocks->frames[f][observation.image_idx],
            &blocks->points[f][i],
            observation.xy);
      ++count;
    }
  }
  return count;
}

size_t CountObservations(Blocks* blocks, size_t f) {
  return VisitObservations(
      blocks, f, [](Blocks::Image*, Eigen::Vector3d*, const Eigen::Vector2d&) {
      });
}

void AddFeaturemetric(const std::vector<ImageBlocks>& images,
                      size_t f,
                      Blocks* blocks,
                      ProgressiveSchedule* schedule) {
  const Frame& frame = blocks->scene.frames[f];
  for (size_t i = 0; i < frame.NumPoints(); ++i) {
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      const Observation& observation = frame.observations[k];
      if (observation.cost_map_idx < 0) continue;
      if (observation.image_idx >= images.size()) continue;
      schedule->AddFeaturemetric(frame.cost_maps,
                                 static_cast<size_t>(observation.cost_map_idx),
                                 images[observation.image_idx],
                                 blocks->points[f][i].data());
    }
  }
}

void RunSchedule(const MultiFrameOptions& options,
                 const StageCallback& callback,
                 Blocks* blocks) {
  ceres::Problem problem;
  ProgressiveSchedule schedule(
      options, blocks->frames.size(), &blocks->cameras, &problem);
  for (size_t f = 0; f < blocks->frames.size(); ++f) {
    ceres::LossFunction* loss =
        schedule.BeginFrame(CountObservations(blocks, f));
    VisitObservations(blocks,
                      f,
                      [&](Blocks::Image* image,
                          Eigen::Vector3d* xyz,
                          const Eigen::Vector2d& xy) {
                        const CameraModel& model =
                            *blocks->cameras[image->camera_idx].model;
                        problem.AddResidualBlock(ColmapCost(model, xy),
                                                 loss,
                                                 image->qvec.data(),
                                                 image->tvec.data(),
                                                 xyz->data(),
                                                 image->params.data());
                      });
    std::vector<ImageBlocks> images;
    for (Blocks::Image& image : blocks->frames[f]) {
      problem.SetManifold(image.qvec.data(), new ceres::QuaternionManifold);
      images.push_back({image.camera_idx,
                        image.qvec.data(),
                        image.tvec.data(),
                        image.params.data()});
    }
    std::vector<double*> points;
    for (Eigen::Vector3d& xyz : blocks->points[f]) {
      if (problem.HasParameterBlock(xyz.data())) points.push_back(xyz.data());
    }
    schedule.EndFrame(images, points);
    AddFeaturemetric(images, f, blocks, &schedule);
  }
  ceres::Solver::Options solver_options;
  solver_options.gradient_tolerance = 0.0;
  solver_options.logging_type = ceres::SILENT;
  schedule.Run(solver_options, callback);
}

MultiFrameOptions PaperOptions() {
  MultiFrameOptions options;
  options.ApplyPreset("paper");
  options.num_threads = 2;
  return options;
}

double Angle(const Eigen::Vector4d& qvec, const Eigen::Quaterniond& known) {
  return Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3))
      .normalized()
      .angularDistance(known);
}

double Find(const std::vector<std::pair<std::string, double>>& list,
            const std::string& name) {
  for (const auto& name_and_value : list) {
    if (name_and_value.first == name) return name_and_value.second;
  }
  return std::numeric_limits<double>::quiet_NaN();
}

TEST(ProgressiveSchedule, DrivesPosesAndIntrinsicsTogether) {
  Blocks blocks = MakeBlocks("PINHOLE");
  std::vector<Stage> stages;
  RunSchedule(
      PaperOptions(),
      [&](const Stage& stage) { stages.push_back(stage); },
      &blocks);
  ASSERT_EQ(stages.size(), 27u);
  for (const std::vector<Blocks::Image>& frame : blocks.frames) {
    for (const Blocks::Image& image : frame) {
      const RigCamera& camera = blocks.cameras[image.camera_idx];
      EXPECT_LT(Angle(image.qvec, camera.cam_from_world.rotation), 1e-4);
      EXPECT_LT((image.tvec - camera.cam_from_world.translation).norm(), 0.1);
      for (size_t j = 0; j < image.params.size(); ++j) {
        EXPECT_NEAR(image.params[j], camera.params[j], 0.05);
      }
    }
  }
  for (const Stage& stage : stages) {
    EXPECT_EQ(stage.name, "schedule");
    EXPECT_NE(stage.termination, "failed");
  }
  EXPECT_LT(stages.back().rms_px, 1.0);
}

TEST(ProgressiveSchedule, WeightsDoubleFromStageToStage) {
  Blocks blocks = MakeBlocks("PINHOLE");
  MultiFrameOptions options = PaperOptions();
  options.max_num_iterations = 1;
  std::vector<Stage> stages;
  RunSchedule(
      options, [&](const Stage& stage) { stages.push_back(stage); }, &blocks);
  ASSERT_EQ(stages.size(), 27u);
  for (int i = 0; i < 27; ++i) {
    const auto& weights = stages[i].weights;
    const double factor = std::ldexp(1.0, i);
    ASSERT_EQ(weights.size(), 5u);  // a pinhole has no distortion
    EXPECT_EQ(Find(weights, "reprojection"), 1.0);
    EXPECT_DOUBLE_EQ(Find(weights, "rotation_prior"), 0.01 * factor);
    EXPECT_DOUBLE_EQ(Find(weights, "translation_prior"), 0.01 * factor);
    EXPECT_DOUBLE_EQ(Find(weights, "focal_variance"), 0.02 * factor);
    EXPECT_DOUBLE_EQ(Find(weights, "principal_point_variance"), 0.02 * factor);
  }
}

// All terms recomputed by hand from the variables at the end of a stage.
TEST(ProgressiveSchedule, CostsAreThoseOfTheObjective) {
  Blocks blocks = MakeBlocks("SIMPLE_RADIAL");
  MultiFrameOptions options = PaperOptions();
  options.max_prior_weight = 0.1;
  options.loss_scale = 0.7;
  options.reprojection_weight = 1.5;
  options.translation_prior_weight = 0.03;
  options.principal_point_variance_weight = 0.05;
  options.extra_params_variance_weight = 0.007;
  const std::vector<RigCamera> initial_cameras = blocks.cameras;
  size_t num_stages = 0;
  const auto half_rho = [&](double squared) {
    const double b = options.loss_scale * options.loss_scale;
    return 0.5 * b * std::log1p(squared / b);
  };
  const auto check = [&](const Stage& stage) {
    double reprojection = 0.0;
    double rotation = 0.0;
    double translation = 0.0;
    double focal = 0.0;
    double principal_point = 0.0;
    double extra = 0.0;
    const double num_frames = static_cast<double>(blocks.frames.size());
    const double num_cameras = static_cast<double>(blocks.cameras.size());
    for (size_t f = 0; f < blocks.frames.size(); ++f) {
      const double num_observations =
          static_cast<double>(CountObservations(&blocks, f));
      VisitObservations(
          &blocks,
          f,
          [&](Blocks::Image* image,
              Eigen::Vector3d* xyz,
              const Eigen::Vector2d& xy) {
            const Eigen::Quaterniond q(
                image->qvec(0), image->qvec(1), image->qvec(2), image->qvec(3));
            const Eigen::Vector3d p = q * *xyz + image->tvec;
            Eigen::Vector2d projected;
            blocks.cameras[image->camera_idx].model->Project(
                image->params.data(),
                p.x() / p.z(),
                p.y() / p.z(),
                projected.data());
            reprojection += half_rho((projected - xy).squaredNorm()) /
                            (num_frames * num_observations);
          });
      const double num_images = static_cast<double>(blocks.frames[f].size());
      for (const Blocks::Image& image : blocks.frames[f]) {
        const RigCamera& camera = blocks.cameras[image.camera_idx];
        const double angle = Angle(image.qvec, camera.cam_from_world.rotation);
        rotation += half_rho(angle * angle) / (num_frames * num_images);
        translation += half_rho((image.tvec - camera.cam_from_world.translation)
                                    .squaredNorm()) /
                       (num_frames * num_images);
        // f, cx, cy, k; a unit of k moves the image corner by |d(xy)/dk|.
        const auto squared = [&](size_t j) {
          return std::pow(image.params[j] - camera.params[j], 2);
        };
        double uv[2];
        const std::vector<double>& initial =
            initial_cameras[image.camera_idx].params;
        camera.model->Unproject(initial.data(), kTestWidth, kTestHeight, uv);
        const double scale = initial[0] * std::pow(std::hypot(uv[0], uv[1]), 3);
        focal += half_rho(squared(0)) / (num_frames * num_cameras);
        principal_point +=
            half_rho(squared(1) + squared(2)) / (num_frames * num_cameras);
        extra +=
            half_rho(squared(3) * scale * scale) / (num_frames * num_cameras);
      }
    }
    const double factor = std::ldexp(1.0, static_cast<int>(num_stages++));
    const auto expect = [&](const char* name, double weight, double cost) {
      EXPECT_DOUBLE_EQ(Find(stage.weights, name), weight) << name;
      EXPECT_NEAR(Find(stage.costs, name), weight * cost, 1e-6 * weight * cost)
          << name;
    };
    ASSERT_EQ(stage.costs.size(), 6u);
    expect("reprojection", 1.5, reprojection);
    expect("rotation_prior", 0.01 * factor, rotation);
    expect("translation_prior", 0.03 * factor, translation);
    expect("focal_variance", 0.02 * factor, focal);
    expect("principal_point_variance", 0.05 * factor, principal_point);
    expect("extra_params_variance", 0.007 * factor, extra);
  };
  RunSchedule(options, check, &blocks);
  EXPECT_EQ(num_stages, 4u);
}

// Mean error (px) of the global focal lengths and principal points.
double IntrinsicsError(const Blocks& blocks, const Scene& truth) {
  double sum = 0.0;
  for (size_t i = 0; i < truth.cameras.size(); ++i) {
    for (size_t j = 0; j < 4; ++j) {
      sum += std::abs(blocks.cameras[i].params[j] - truth.cameras[i].params[j]);
    }
  }
  return sum / static_cast<double>(4 * truth.cameras.size());
}

TEST(ProgressiveSchedule, FeaturemetricTermFollowsTheFeatures) {
  const Scene truth = MakeTestScene(BlockOptions("PINHOLE")).truth.scene;
  double errors[2];
  for (const bool with_features : {false, true}) {
    Blocks blocks = MakeBlocks("PINHOLE");
    if (with_features) {
      for (size_t f = 0; f < truth.frames.size(); ++f) {
        AddBowlCostMaps(0.3, 0.5, truth.frames[f], &blocks.scene.frames[f]);
      }
    }
    MultiFrameOptions options = PaperOptions();
    options.featuremetric_weight = 10.0;
    RunSchedule(
        options,
        [&](const Stage& stage) {
          EXPECT_EQ(Find(stage.weights, "featuremetric") == 10.0,
                    with_features);
        },
        &blocks);
    errors[with_features] = IntrinsicsError(blocks, truth);
  }
  EXPECT_LT(errors[1], 0.3 * errors[0]);
}

TEST(ProgressiveSchedule, CostOfTheFeaturemetricTerm) {
  const Scene truth = MakeTestScene(BlockOptions("PINHOLE")).truth.scene;
  Blocks blocks = MakeBlocks("PINHOLE");
  // In frame 1, and for half of the observations.
  AddBowlCostMaps(0.3, 0.05, truth.frames[1], &blocks.scene.frames[1]);
  Frame& frame = blocks.scene.frames[1];
  for (size_t k = 0; k < frame.observations.size(); k += 2) {
    frame.observations[k].cost_map_idx = -1;
  }
  MultiFrameOptions options = PaperOptions();
  options.progressive = false;
  options.featuremetric_weight = 0.2;
  options.loss_scale = 0.7;
  const auto check = [&](const Stage& stage) {
    double cost = 0.0;
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        if (observation.cost_map_idx < 0) continue;
        if (observation.image_idx >= blocks.frames[1].size()) continue;
        const Blocks::Image& image = blocks.frames[1][observation.image_idx];
        const Eigen::Quaterniond q(
            image.qvec(0), image.qvec(1), image.qvec(2), image.qvec(3));
        const Eigen::Vector3d p = q * blocks.points[1][i] + image.tvec;
        const Eigen::Vector2d xy(
            image.params[0] * p.x() / p.z() + image.params[2],
            image.params[1] * p.y() / p.z() + image.params[3]);
        const Eigen::Vector2d d = xy - truth.frames[1].observations[k].xy;
        ASSERT_LT(d.norm(), 6.0);
        const double squared = 0.09 + 0.0025 * d.squaredNorm();
        const double squared_gradient =
            0.0025 * 0.0025 * d.squaredNorm() / squared;
        cost += 0.5 * 0.49 * std::log1p((squared + squared_gradient) / 0.49);
      }
    }
    cost *= 0.2 / (2.0 * static_cast<double>(CountObservations(&blocks, 1)));
    EXPECT_NEAR(Find(stage.costs, "featuremetric"), cost, 1e-3 * cost);
  };
  RunSchedule(options, check, &blocks);
}

TEST(ProgressiveSchedule, NonProgressiveIsOneSolveAtTheInitialWeights) {
  Blocks blocks = MakeBlocks("PINHOLE");
  MultiFrameOptions options = PaperOptions();
  options.progressive = false;
  std::vector<Stage> stages;
  RunSchedule(
      options, [&](const Stage& stage) { stages.push_back(stage); }, &blocks);
  ASSERT_EQ(stages.size(), 1u);
  EXPECT_EQ(Find(stages[0].weights, "rotation_prior"), 0.01);
}

TEST(ProgressiveSchedule, TermsOfWeightZeroAreLeftOut) {
  Blocks blocks = MakeBlocks("PINHOLE");
  const std::vector<RigCamera> before = blocks.cameras;
  MultiFrameOptions options = PaperOptions();
  options.progressive = false;
  options.focal_variance_weight = 0.0;
  options.principal_point_variance_weight = 0.0;
  options.translation_prior_weight = 0.0;
  RunSchedule(
      options,
      [&](const Stage& stage) {
        ASSERT_EQ(stage.weights.size(), 2u);
        EXPECT_EQ(stage.weights[0].first, "reprojection");
        EXPECT_EQ(stage.weights[1].first, "rotation_prior");
      },
      &blocks);
  // Nothing ties the global intrinsics.
  for (size_t i = 0; i < before.size(); ++i) {
    EXPECT_EQ(blocks.cameras[i].params, before[i].params);
  }
}

TEST(ProgressiveSchedule, GlobalParametersWithoutATermStay) {
  Blocks blocks = MakeBlocks("PINHOLE");
  const std::vector<RigCamera> before = blocks.cameras;
  MultiFrameOptions options = PaperOptions();
  options.progressive = false;
  options.principal_point_variance_weight = 0.0;
  RunSchedule(
      options, [](const Stage&) {}, &blocks);
  for (size_t i = 0; i < before.size(); ++i) {
    EXPECT_NE(blocks.cameras[i].params[0], before[i].params[0]);
    EXPECT_EQ(blocks.cameras[i].params[2], before[i].params[2]);
    EXPECT_EQ(blocks.cameras[i].params[3], before[i].params[3]);
  }
}

TEST(ProgressiveSchedule, FailedSolvesAreReportedAndThrow) {
  Blocks blocks = MakeBlocks("PINHOLE");
  blocks.points[0][0].setConstant(std::numeric_limits<double>::quiet_NaN());
  std::string termination;
  EXPECT_THROW(RunSchedule(
                   PaperOptions(),
                   [&](const Stage& stage) { termination = stage.termination; },
                   &blocks),
               SolverError);
  EXPECT_EQ(termination, "failed");
}

}  // namespace
}  // namespace mfir
