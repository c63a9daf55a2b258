#include "src/fixed_extrinsics_solver.h"

#include <algorithm>
#include <memory>
#include <numeric>

#include <Eigen/Dense>
#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "tests/test_scenes.h"

namespace mfir {
namespace {

const ceres::TrivialLoss kTrivialLoss;

FixedExtrinsicsOptions Options(const ceres::LossFunction* loss) {
  FixedExtrinsicsOptions options;
  options.loss = loss;
  return options;
}

// The problem of the header with COLMAP's residuals.
void BuildCeresProblem(const ceres::LossFunction* loss,
                       Scene* scene,
                       ceres::Problem* problem) {
  for (Frame& frame : scene->frames) {
    for (size_t i = 0; i < frame.points.size(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        RigCamera& camera =
            scene->cameras[frame.images[observation.image_idx].camera_idx];
        problem->AddResidualBlock(
            ColmapCost(*camera.model, camera.cam_from_world, observation.xy),
            const_cast<ceres::LossFunction*>(loss),
            frame.points[i].data(),
            camera.params.data());
      }
    }
  }
}

ceres::Problem::Options SharedLoss() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

double SolveWithCeres(const ceres::LossFunction* loss, Scene* scene) {
  ceres::Problem problem(SharedLoss());
  BuildCeresProblem(loss, scene, &problem);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-17;
  options.gradient_tolerance = 1e-17;
  options.parameter_tolerance = 1e-13;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  EXPECT_TRUE(summary.IsSolutionUsable());
  return summary.final_cost;
}

class CeresTest : public testing::TestWithParam<const char*> {};

INSTANTIATE_TEST_SUITE_P(
    Models,
    CeresTest,
    testing::Values("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "OPENCV"));

TEST_P(CeresTest, SameMinimumFromTheSameStart) {
  TestSceneOptions scene_options;
  scene_options.model = GetParam();
  scene_options.noise = 0.7;
  Scene ours = MakeTestScene(scene_options).start;
  Scene ceres_scene = ours;
  const ceres::CauchyLoss loss(2.0);
  const FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(Options(&loss), &ours);
  EXPECT_TRUE(summary.converged);
  const double ceres_cost = SolveWithCeres(&loss, &ceres_scene);
  EXPECT_NEAR(summary.final_cost, ceres_cost, 1e-9 * ceres_cost);
  EXPECT_LT(MaxParamsDifference(ours, ceres_scene), 1e-7);
}

// With outliers there is more than one minimum: Ceres must stay in ours.
TEST_P(CeresTest, OurMinimumIsOneOfCeres) {
  TestSceneOptions scene_options;
  scene_options.model = GetParam();
  scene_options.outlier_share = 0.1;
  Scene ours = MakeTestScene(scene_options).start;
  const ceres::CauchyLoss loss(1.0);
  const FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(Options(&loss), &ours);
  EXPECT_TRUE(summary.converged);
  EXPECT_LT(summary.final_cost, summary.initial_cost);
  Scene ceres_scene = ours;
  const double ceres_cost = SolveWithCeres(&loss, &ceres_scene);
  EXPECT_NEAR(summary.final_cost, ceres_cost, 1e-9 * ceres_cost);
  EXPECT_LT(MaxParamsDifference(ceres_scene, ours), 1e-7);
}

// Schur complement and reduced gradient of the normal equations that Ceres has
// with COLMAP's residuals.
void ReducedSystem(Scene* scene,
                   Eigen::MatrixXd* schur,
                   Eigen::VectorXd* gradient) {
  ceres::Problem problem(SharedLoss());
  BuildCeresProblem(nullptr, scene, &problem);
  ceres::Problem::EvaluateOptions options;
  Eigen::Index num_params = 0;
  Eigen::Index num_points = 0;
  for (RigCamera& camera : scene->cameras) {
    options.parameter_blocks.push_back(camera.params.data());
    num_params += static_cast<Eigen::Index>(camera.params.size());
  }
  for (Frame& frame : scene->frames) {
    for (Eigen::Vector3d& xyz : frame.points) {
      options.parameter_blocks.push_back(xyz.data());
      num_points += 3;
    }
  }
  std::vector<double> residuals;
  ceres::CRSMatrix crs;
  ASSERT_TRUE(problem.Evaluate(options, nullptr, &residuals, nullptr, &crs));
  Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(crs.num_rows, crs.num_cols);
  for (int row = 0; row < crs.num_rows; ++row) {
    for (int k = crs.rows[row]; k < crs.rows[row + 1]; ++k) {
      jacobian(row, crs.cols[k]) = crs.values[k];
    }
  }
  const Eigen::MatrixXd hessian = jacobian.transpose() * jacobian;
  const Eigen::VectorXd full_gradient =
      jacobian.transpose() *
      Eigen::Map<Eigen::VectorXd>(residuals.data(), residuals.size());
  const Eigen::MatrixXd back =
      hessian.bottomRightCorner(num_points, num_points)
          .llt()
          .solve(hessian.bottomLeftCorner(num_points, num_params));
  *schur = hessian.topLeftCorner(num_params, num_params) -
           hessian.topRightCorner(num_params, num_points) * back;
  *gradient = full_gradient.head(num_params) -
              back.transpose() * full_gradient.tail(num_points);
}

TEST(FixedExtrinsicsSolver, FirstStepIsTheNewtonStepOfTheReducedSystem) {
  TestSceneOptions scene_options;
  scene_options.model = "SIMPLE_RADIAL";
  scene_options.num_points = 40;
  Scene scene = MakeTestScene(scene_options).start;
  FixedExtrinsicsOptions options = Options(&kTrivialLoss);
  options.max_num_iterations = 0;  // moves the points to their minima
  SolveFixedExtrinsics(options, &scene);
  Eigen::MatrixXd schur;
  Eigen::VectorXd gradient;
  Scene at_start = scene;
  ReducedSystem(&at_start, &schur, &gradient);

  options.max_num_iterations = 1;
  SolveFixedExtrinsics(options, &scene);
  Eigen::VectorXd step(gradient.size());
  Eigen::Index k = 0;
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    for (size_t j = 0; j < scene.cameras[i].params.size(); ++j) {
      step(k++) =
          scene.cameras[i].params[j] - at_start.cameras[i].params[j];
    }
  }
  // (S + damping diag(S)) step = -gradient with some small damping.
  const Eigen::VectorXd damped =
      schur.diagonal().cwiseSqrt().asDiagonal() * step;
  const Eigen::VectorXd scale = schur.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::VectorXd rest =
      scale.asDiagonal() * (-gradient - schur * step);
  const double damping = rest.dot(damped) / damped.squaredNorm();
  EXPECT_GE(damping, -1e-9);
  EXPECT_LE(damping, 1e-3);
  EXPECT_LT((rest - damping * damped).norm(),
            1e-6 * (scale.asDiagonal() * gradient).norm());
}

class RefineTest
    : public testing::TestWithParam<std::tuple<const CameraModel*, int>> {};

INSTANTIATE_TEST_SUITE_P(
    ModelsAndFlags,
    RefineTest,
    testing::Combine(testing::ValuesIn(AllCameraModels()),
                     testing::Range(0, 8)),
    [](const auto& info) {
      return std::get<0>(info.param)->Name() + "_" +
             std::to_string(std::get<1>(info.param));
    });

TEST_P(RefineTest, HeldParametersAreBitIdentical) {
  const CameraModel& model = *std::get<0>(GetParam());
  const int flags = std::get<1>(GetParam());
  TestSceneOptions scene_options;
  scene_options.model = model.Name();
  scene_options.num_cameras = 5;
  scene_options.num_frames = 1;
  scene_options.num_points = 60;
  scene_options.outlier_share = 0.05;
  const Scene start = MakeTestScene(scene_options).start;
  Scene scene = start;
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = Options(&loss);
  options.refine_focal_length = flags & 1;
  options.refine_principal_point = flags & 2;
  options.refine_extra_params = flags & 4;
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &scene);
  EXPECT_LE(summary.final_cost, summary.initial_cost);

  std::vector<bool> refined(model.NumParams(), false);
  const auto mark = [&](bool refine, const std::vector<size_t>& idxs) {
    for (const size_t idx : idxs) refined[idx] = refine;
  };
  mark(options.refine_focal_length, model.FocalLengthIdxs());
  mark(options.refine_principal_point, model.PrincipalPointIdxs());
  mark(options.refine_extra_params, model.ExtraParamsIdxs());
  ASSERT_EQ(static_cast<size_t>(summary.covariance.rows()),
            5 * model.NumParams());
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    EXPECT_EQ(scene.cameras[i].cam_from_world.translation,
              start.cameras[i].cam_from_world.translation);
    EXPECT_EQ(scene.cameras[i].cam_from_world.rotation.coeffs(),
              start.cameras[i].cam_from_world.rotation.coeffs());
    for (size_t j = 0; j < refined.size(); ++j) {
      const double before = start.cameras[i].params[j];
      const double after = scene.cameras[i].params[j];
      const Eigen::Index row =
          static_cast<Eigen::Index>(i * refined.size() + j);
      EXPECT_TRUE(std::isfinite(after));
      if (refined[j]) {
        EXPECT_NE(after, before) << "camera " << i << ", parameter " << j;
      } else {
        EXPECT_EQ(after, before) << "camera " << i << ", parameter " << j;
        EXPECT_TRUE(summary.covariance.row(row).isZero(0.0));
      }
    }
  }
  // Eight distortion parameters of five cameras and 60 points are not
  // determined well enough for every model to promise convergence.
  if (!options.refine_extra_params || model.ExtraParamsIdxs().size() < 4) {
    EXPECT_TRUE(summary.converged);
  }
}

// 1200 points: several chunks of work.
TEST(FixedExtrinsicsSolver, ResultDoesNotDependOnTheNumberOfThreads) {
  TestSceneOptions scene_options;
  scene_options.num_points = 600;
  scene_options.track_length = 4;
  scene_options.outlier_share = 0.05;
  const Scene start = MakeTestScene(scene_options).start;
  const ceres::CauchyLoss loss(1.0);
  Scene expected;
  FixedExtrinsicsSummary expected_summary;
  for (const int num_threads : {1, 2, 3, 8}) {
    Scene scene = start;
    FixedExtrinsicsOptions options = Options(&loss);
    options.num_threads = num_threads;
    options.compute_covariance = true;
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(options, &scene);
    if (num_threads == 1) {
      expected = scene;
      expected_summary = summary;
    }
    for (size_t i = 0; i < scene.cameras.size(); ++i) {
      EXPECT_EQ(scene.cameras[i].params, expected.cameras[i].params);
    }
    for (size_t i = 0; i < scene.frames.size(); ++i) {
      EXPECT_EQ(scene.frames[i].points, expected.frames[i].points);
    }
    EXPECT_EQ(summary.final_cost, expected_summary.final_cost);
    EXPECT_EQ(summary.num_iterations, expected_summary.num_iterations);
    EXPECT_EQ(summary.covariance, expected_summary.covariance);
  }
}

// Another order of frames, images, points and observations.
Scene Permuted(const Scene& scene, Random* random) {
  const auto shuffled = [&](size_t count) {
    std::vector<size_t> order(count);
    std::iota(order.begin(), order.end(), 0);
    for (size_t i = count - 1; i > 0; --i) {
      std::swap(order[i], order[random->Integer(0, static_cast<int>(i))]);
    }
    return order;
  };
  Scene permuted = scene;
  permuted.frames.clear();
  for (const size_t f : shuffled(scene.frames.size())) {
    const Frame& frame = scene.frames[f];
    Frame& new_frame = permuted.frames.emplace_back();
    const std::vector<size_t> image_order = shuffled(frame.images.size());
    std::vector<size_t> new_image_idxs(frame.images.size());
    for (size_t i = 0; i < image_order.size(); ++i) {
      new_frame.images.push_back(frame.images[image_order[i]]);
      new_image_idxs[image_order[i]] = i;
    }
    for (const size_t p : shuffled(frame.points.size())) {
      new_frame.points.push_back(frame.points[p]);
      const size_t begin = frame.track_begins[p];
      for (const size_t k : shuffled(frame.track_begins[p + 1] - begin)) {
        Observation observation = frame.observations[begin + k];
        observation.image_idx = new_image_idxs[observation.image_idx];
        new_frame.observations.push_back(observation);
      }
      new_frame.track_begins.push_back(new_frame.observations.size());
    }
  }
  return permuted;
}

TEST(FixedExtrinsicsSolver, ResultDoesNotDependOnTheOrderOfTheData) {
  TestSceneOptions scene_options;
  scene_options.num_frames = 3;
  scene_options.track_length = 5;
  Scene scene = MakeTestScene(scene_options).start;
  Random random({9});
  const ceres::CauchyLoss loss(2.0);
  std::vector<Scene> permuted;
  for (int i = 0; i < 3; ++i) permuted.push_back(Permuted(scene, &random));
  const FixedExtrinsicsSummary expected =
      SolveFixedExtrinsics(Options(&loss), &scene);
  EXPECT_TRUE(expected.converged);
  for (Scene& other : permuted) {
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(Options(&loss), &other);
    EXPECT_NEAR(summary.final_cost,
                expected.final_cost,
                1e-12 * expected.final_cost);
    EXPECT_LT(MaxParamsDifference(other, scene), 1e-9);
  }
}

// A frame of weight 2 is the frame twice, one of weight 0 is none.
TEST(FixedExtrinsicsSolver, FrameWeightsCountFrames) {
  const ceres::CauchyLoss loss(2.0);
  const Scene start = MakeTestScene({}).start;
  Scene weighted = start;
  FixedExtrinsicsOptions options = Options(&loss);
  options.frame_weights = {2.0, 1.0};
  const double weighted_cost =
      SolveFixedExtrinsics(options, &weighted).final_cost;
  Scene twice = start;
  twice.frames.push_back(twice.frames[0]);
  const double twice_cost =
      SolveFixedExtrinsics(Options(&loss), &twice).final_cost;
  EXPECT_NEAR(weighted_cost, twice_cost, 1e-11 * twice_cost);
  EXPECT_LT(MaxParamsDifference(weighted, twice), 1e-9);

  Scene equal = start;
  SolveFixedExtrinsics(Options(&loss), &equal);
  EXPECT_GT(MaxParamsDifference(weighted, equal), 1e-5);

  Scene only_first = start;
  options.frame_weights = {1.0, 0.0};
  EXPECT_TRUE(SolveFixedExtrinsics(options, &only_first).converged);
  Scene first = start;
  first.frames.resize(1);
  SolveFixedExtrinsics(Options(&loss), &first);
  EXPECT_LT(MaxParamsDifference(only_first, first), 1e-9);
}

TEST(FixedExtrinsicsSolver, CommonFactorOfTheWeightsDoesNotMatter) {
  const ceres::CauchyLoss loss(2.0);
  const Scene start = MakeTestScene({}).start;
  Scene expected = start;
  SolveFixedExtrinsics(Options(&loss), &expected);
  for (const double weight : {1e-9, 1e9}) {
    Scene scene = start;
    FixedExtrinsicsOptions options = Options(&loss);
    options.frame_weights = {weight, weight};
    EXPECT_TRUE(SolveFixedExtrinsics(options, &scene).converged);
    EXPECT_LT(MaxParamsDifference(scene, expected), 1e-9);
  }
}

void RemoveObservation(size_t point_idx, size_t observation_idx, Frame* frame) {
  frame->observations.erase(frame->observations.begin() +
                            static_cast<std::ptrdiff_t>(observation_idx));
  for (size_t i = point_idx + 1; i < frame->track_begins.size(); ++i) {
    --frame->track_begins[i];
  }
}

TEST(FixedExtrinsicsSolver, ObservationsBehindTheCameraTakeNoPart) {
  Scene without = MakeTestScene({}).start;
  Frame& frame = without.frames[0];
  // Just behind camera 0, which has the track's first observation.
  for (size_t k = frame.track_begins[5]; k < frame.track_begins[6]; ++k) {
    if (frame.observations[k].image_idx == 0) {
      std::swap(frame.observations[k],
                frame.observations[frame.track_begins[5]]);
    }
  }
  const RigCamera& behind = without.cameras[0];
  frame.points[5] = behind.cam_from_world.Center() -
                    behind.cam_from_world.rotation.conjugate() *
                        Eigen::Vector3d(0.01, 0.02, 0.1);
  Scene with = without;
  const size_t removed = frame.track_begins[5];
  RemoveObservation(5, removed, &frame);
  EXPECT_TRUE(std::isinf(SquaredResiduals(with)[removed]));

  const ceres::CauchyLoss loss(1.0);
  const FixedExtrinsicsSummary expected =
      SolveFixedExtrinsics(Options(&loss), &without);
  const FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(Options(&loss), &with);
  EXPECT_TRUE(summary.converged);
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  EXPECT_NEAR(summary.final_cost, expected.final_cost, 1e-9);
  EXPECT_LT(MaxParamsDifference(with, without), 1e-9);
}

TEST(FixedExtrinsicsSolver, PointsOfOneObservationOrNoneStayAsTheyAre) {
  const Scene start = MakeTestScene({}).start;
  Scene expected = start;
  Scene scene = start;
  Frame& frame = scene.frames[1];
  const Eigen::Vector3d single(0.1, 0.2, 0.3);
  frame.points.push_back(single);
  frame.observations.push_back({2, Eigen::Vector2d(400, 300)});
  frame.track_begins.push_back(frame.observations.size());
  frame.points.push_back(2.0 * single);
  frame.track_begins.push_back(frame.observations.size());
  const ceres::CauchyLoss loss(1.0);
  SolveFixedExtrinsics(Options(&loss), &expected);
  EXPECT_TRUE(SolveFixedExtrinsics(Options(&loss), &scene).converged);
  EXPECT_EQ(frame.points[frame.points.size() - 2], single);
  EXPECT_EQ(frame.points.back(), 2.0 * single);
  EXPECT_LT(MaxParamsDifference(scene, expected), 1e-9);
}

TEST(FixedExtrinsicsSolver, CamerasWithoutObservationsStayAsTheyAre) {
  const Scene start = MakeTestScene({}).start;
  Scene scene = start;
  RigCamera unobserved = start.cameras[0];
  unobserved.params = {900, 901, 402, 303};
  scene.cameras.insert(scene.cameras.begin(), unobserved);
  unobserved.model = nullptr;  // not even an image
  unobserved.params.clear();
  scene.cameras.push_back(unobserved);
  for (Frame& frame : scene.frames) {
    for (FrameImage& image : frame.images) ++image.camera_idx;
  }
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = Options(&loss);
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &scene);
  EXPECT_TRUE(summary.converged);
  EXPECT_EQ(scene.cameras[0].params,
            (std::vector<double>{900, 901, 402, 303}));
  Scene expected = start;
  SolveFixedExtrinsics(options, &expected);
  for (size_t i = 0; i < expected.cameras.size(); ++i) {
    EXPECT_EQ(scene.cameras[i + 1].params, expected.cameras[i].params);
  }
  // Not determined by anything.
  ASSERT_EQ(summary.covariance.rows(), 4 + 8 * 4);
  EXPECT_TRUE(std::isnan(summary.covariance(0, 0)));
  EXPECT_GT(summary.covariance(4, 4), 0.0);
}

TEST(FixedExtrinsicsSolver, EmptyScenesAndNothingToRefineConverge) {
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = Options(&loss);
  options.compute_covariance = true;
  Scene empty;
  EXPECT_TRUE(SolveFixedExtrinsics(options, &empty).converged);
  Scene no_frames = MakeTestScene({}).start;
  no_frames.frames.clear();
  EXPECT_TRUE(SolveFixedExtrinsics(options, &no_frames).converged);

  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  Scene scene = MakeTestScene({}).start;
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &scene);
  EXPECT_TRUE(summary.converged);
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  EXPECT_TRUE(summary.covariance.isZero(0.0));
}

class NoiseFreeTest : public testing::TestWithParam<const char*> {};

INSTANTIATE_TEST_SUITE_P(Models,
                         NoiseFreeTest,
                         testing::Values("SIMPLE_PINHOLE", "PINHOLE",
                                         "SIMPLE_RADIAL", "OPENCV", "FOV",
                                         "OPENCV_FISHEYE"));

TEST_P(NoiseFreeTest, RecoversTheTruth) {
  TestSceneOptions scene_options;
  scene_options.model = GetParam();
  scene_options.noise = 0.0;
  TestScene scene = MakeTestScene(scene_options);
  const ceres::CauchyLoss cauchy(1.0);
  for (const ceres::LossFunction* loss :
       {static_cast<const ceres::LossFunction*>(&cauchy),
        static_cast<const ceres::LossFunction*>(&kTrivialLoss)}) {
    Scene start = scene.start;
    EXPECT_TRUE(SolveFixedExtrinsics(Options(loss), &start).converged);
    EXPECT_LT(MaxParamsDifference(start, scene.truth), 1e-7);
    // Started at the solution, cost zero.
    Scene at_truth = scene.truth;
    EXPECT_TRUE(SolveFixedExtrinsics(Options(loss), &at_truth).converged);
    EXPECT_LT(MaxParamsDifference(at_truth, scene.truth), 1e-9);
  }
}

TEST(FixedExtrinsicsSolver, HugeOutliersDoNotMatter) {
  for (const double size : {300.0, 1e6}) {
    TestSceneOptions scene_options;
    scene_options.num_points = 300;
    scene_options.outlier_share = 0.1;
    scene_options.outlier_size = size;
    // The points are close enough for their inliers to win.
    scene_options.start_error = 0.3;
    TestScene scene = MakeTestScene(scene_options);
    const ceres::CauchyLoss loss(1.0);
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(Options(&loss), &scene.start);
    EXPECT_TRUE(summary.converged) << size;
    // 0.5 px of noise, 600 points: focal lengths to about 0.2 px.
    EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 5e-3) << size;
  }
}

TEST(FixedExtrinsicsSolver, RelinearizesFromAFarStart) {
  TestSceneOptions scene_options;
  scene_options.start_error = 8.0;  // focal lengths off by 8 %, points by 0.08
  TestScene scene = MakeTestScene(scene_options);
  const FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(Options(&kTrivialLoss), &scene.start);
  EXPECT_TRUE(summary.converged);
  EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 5e-3);
}

// J^T J of Ceres at the solution against the sandwich.
TEST(FixedExtrinsicsSolver, CovarianceIsThatOfCeresOnAverage) {
  constexpr int kNumSeeds = 8;
  constexpr double kNoise = 0.5;
  double sum = 0.0;
  double count = 0.0;
  for (uint64_t seed = 0; seed < kNumSeeds; ++seed) {
    TestSceneOptions scene_options;
    scene_options.num_cameras = 6;
    scene_options.num_frames = 1;
    scene_options.noise = kNoise;
    scene_options.seed = 20 + seed;
    Scene scene = MakeTestScene(scene_options).start;
    FixedExtrinsicsOptions options = Options(&kTrivialLoss);
    options.compute_covariance = true;
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(options, &scene);

    ceres::Problem problem(SharedLoss());
    BuildCeresProblem(nullptr, &scene, &problem);
    ceres::Covariance::Options covariance_options;
    covariance_options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(covariance_options);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (const RigCamera& camera : scene.cameras) {
      blocks.emplace_back(camera.params.data(), camera.params.data());
    }
    ASSERT_TRUE(covariance.Compute(blocks, &problem));
    for (size_t i = 0; i < scene.cameras.size(); ++i) {
      const double* params = scene.cameras[i].params.data();
      Eigen::Matrix<double, 4, 4, Eigen::RowMajor> expected;
      covariance.GetCovarianceBlock(params, params, expected.data());
      for (Eigen::Index j = 0; j < 4; ++j) {
        const Eigen::Index row = static_cast<Eigen::Index>(4 * i) + j;
        const double ratio =
            summary.covariance(row, row) / (kNoise * kNoise * expected(j, j));
        EXPECT_GT(ratio, 0.3);
        EXPECT_LT(ratio, 3.0);
        sum += ratio;
        count += 1.0;
      }
    }
  }
  EXPECT_NEAR(sum / count, 1.0, 0.2);
}

TEST(FixedExtrinsicsSolver, ErrorsAreOfTheSizeThatTheCovarianceTells) {
  for (const bool outliers : {false, true}) {
    double sum = 0.0;
    double count = 0.0;
    for (uint64_t seed = 0; seed < 20; ++seed) {
      TestSceneOptions scene_options;
      scene_options.num_points = 150;
      scene_options.seed = 100 + seed;
      scene_options.outlier_share = outliers ? 0.05 : 0.0;
      scene_options.start_error = 0.3;
      TestScene scene = MakeTestScene(scene_options);
      const ceres::CauchyLoss cauchy(1.0);
      FixedExtrinsicsOptions options = Options(
          outliers ? static_cast<const ceres::LossFunction*>(&cauchy)
                   : &kTrivialLoss);
      options.compute_covariance = true;
      const FixedExtrinsicsSummary summary =
          SolveFixedExtrinsics(options, &scene.start);
      EXPECT_TRUE(summary.converged);
      for (size_t i = 0; i < scene.truth.cameras.size(); ++i) {
        for (size_t j = 0; j < 4; ++j) {
          const double error = scene.start.cameras[i].params[j] -
                               scene.truth.cameras[i].params[j];
          const Eigen::Index row = static_cast<Eigen::Index>(4 * i + j);
          sum += error * error / summary.covariance(row, row);
          count += 1.0;
        }
      }
    }
    EXPECT_GT(sum / count, 0.7) << outliers;
    EXPECT_LT(sum / count, 1.4) << outliers;
  }
}

class TrackLengthTest : public testing::TestWithParam<size_t> {};

INSTANTIATE_TEST_SUITE_P(Views, TrackLengthTest, testing::Values(2, 3, 10));

TEST_P(TrackLengthTest, NoiseSamplesHaveTheSigmaOfTheNoise) {
  TestSceneOptions scene_options;
  scene_options.num_cameras = 10;
  scene_options.track_length = GetParam();
  scene_options.num_points = 12000 / GetParam();
  scene_options.noise = 0.5;
  Scene scene = MakeTestScene(scene_options).start;
  EXPECT_TRUE(SolveFixedExtrinsics(Options(&kTrivialLoss), &scene).converged);
  for (const bool robust : {false, true}) {
    const ceres::CauchyLoss cauchy(2.385 * scene_options.noise);
    const std::vector<NoiseSample> samples =
        NoiseSamples(scene, robust ? &cauchy : nullptr);
    double degrees_of_freedom = 0.0;
    double sum = 0.0;
    for (const NoiseSample& sample : samples) {
      ASSERT_GE(sample.squared, 0.0);
      ASSERT_GT(sample.weight, 0.0);
      ASSERT_LE(sample.weight, 1.0);
      degrees_of_freedom += sample.weight;
      sum += sample.weight * sample.squared;
    }
    if (!robust) {
      const double expected = (2.0 * GetParam() - 3.0) *
                              static_cast<double>(scene.frames.size()) *
                              static_cast<double>(scene_options.num_points);
      EXPECT_LE(degrees_of_freedom, expected * (1.0 + 1e-9));
      EXPECT_GT(degrees_of_freedom, 0.9 * expected);
      EXPECT_NEAR(std::sqrt(sum / degrees_of_freedom), 0.5, 0.015);
    }
    EXPECT_NEAR(RobustStd(samples), 0.5, 0.025) << "robust: " << robust;
  }
}

TEST(RobustStd, IsThatOfTheWeightedMedian) {
  EXPECT_EQ(RobustStd({}), 0.0);
  // Median of squares of a standard normal variable: 0.4549.
  EXPECT_NEAR(RobustStd({{4.0 * 0.45493642, 1.0}}), 2.0, 1e-8);
  EXPECT_NEAR(RobustStd({{1e9, 0.4}, {0.45493642, 0.5}, {0.0, 0.05}}),
              1.0,
              1e-8);
}

}  // namespace
}  // namespace mfir
