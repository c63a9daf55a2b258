#include "colmap_ext/models/camera_models.h"

#include <memory>
#include <optional>
#include <utility>

#include <gtest/gtest.h>

#include "colmap_ext/host/camera.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// Rays over the field of view of TypicalParams, the centre included.
std::vector<Eigen::Vector2d> Rays() {
  std::vector<Eigen::Vector2d> rays;
  for (double u = -0.4; u < 0.45; u += 0.1) {
    for (double v = -0.3; v < 0.35; v += 0.1) {
      rays.emplace_back(u, v);
    }
  }
  rays.emplace_back(0.0, 0.0);
  return rays;
}

class CameraModelTest : public testing::TestWithParam<const CameraModel*> {
 protected:
  const CameraModel& model_ = *GetParam();
  const std::vector<double> params_ = TypicalParams(*GetParam());
};

INSTANTIATE_TEST_SUITE_P(All,
                         CameraModelTest,
                         testing::ValuesIn(AllCameraModels()),
                         [](const auto& info) { return info.param->Name(); });

TEST_P(CameraModelTest, IdentifiersAndIndicesAreColmaps) {
  const int id = CameraModelId(model_);
  EXPECT_EQ(FindCameraModel(id), &model_);
  EXPECT_EQ(FindCameraModel(model_.Name()), &model_);
  const host::Camera camera = host::MakeCamera(1, id, 800, 600, params_);
  EXPECT_EQ(camera.ModelName(), model_.Name());
  EXPECT_TRUE(camera.VerifyParams());
  const auto as_vector = [](const auto& idxs) {
    return std::vector<size_t>(idxs.begin(), idxs.end());
  };
  EXPECT_EQ(model_.FocalLengthIdxs(), as_vector(camera.FocalLengthIdxs()));
  EXPECT_EQ(model_.PrincipalPointIdxs(),
            as_vector(camera.PrincipalPointIdxs()));
  EXPECT_EQ(model_.ExtraParamsIdxs(), as_vector(camera.ExtraParamsIdxs()));
}

TEST_P(CameraModelTest, ProjectEqualsImgFromCam) {
  const host::Camera camera =
      host::MakeCamera(1, CameraModelId(model_), 800, 600, params_);
  for (const Eigen::Vector2d& uv : Rays()) {
    Eigen::Vector2d xy;
    model_.Project(params_.data(), uv.x(), uv.y(), xy.data());
    EXPECT_EQ(xy, host::ImgFromCam(camera, uv.homogeneous())) << uv.transpose();
  }
}

TEST_P(CameraModelTest, UnprojectInvertsProject) {
  for (const Eigen::Vector2d& uv : Rays()) {
    Eigen::Vector2d xy;
    Eigen::Vector2d back;
    model_.Project(params_.data(), uv.x(), uv.y(), xy.data());
    model_.Unproject(params_.data(), xy.x(), xy.y(), back.data());
    // COLMAP's iteration ends with a step of 1e-5 and converges quadratically.
    EXPECT_LT((back - uv).norm(), 1e-8) << uv.transpose();
  }
}

TEST_P(CameraModelTest, JacobianEqualsCentralDifferences) {
  const size_t n = model_.NumParams();
  for (const Eigen::Vector2d& uv : Rays()) {
    Eigen::Vector2d xy;
    Eigen::Vector2d value;
    Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
    Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> jacobian(2, n);
    model_.ProjectWithJacobian(params_.data(),
                               uv.x(),
                               uv.y(),
                               xy.data(),
                               jacobian_uv.data(),
                               jacobian.data());
    model_.Project(params_.data(), uv.x(), uv.y(), value.data());
    EXPECT_LT((xy - value).norm(), 1e-10);

    // Larger than the truncation of FOV's series next to its axis would need.
    const double step = 1e-5;
    for (int axis = 0; axis < 2; ++axis) {
      Eigen::Vector2d plus = uv;
      Eigen::Vector2d minus = uv;
      plus(axis) += step;
      minus(axis) -= step;
      Eigen::Vector2d xy_plus;
      Eigen::Vector2d xy_minus;
      model_.Project(params_.data(), plus.x(), plus.y(), xy_plus.data());
      model_.Project(params_.data(), minus.x(), minus.y(), xy_minus.data());
      const Eigen::Vector2d numeric = (xy_plus - xy_minus) / (2.0 * step);
      EXPECT_LT((jacobian_uv.col(axis) - numeric).norm(),
                1e-6 * jacobian_uv.norm())
          << "ray " << uv.transpose() << ", axis " << axis;
    }
    for (size_t i = 0; i < n; ++i) {
      const double param_step = 1e-6 * std::max(1.0, std::abs(params_[i]));
      std::vector<double> plus = params_;
      std::vector<double> minus = params_;
      plus[i] += param_step;
      minus[i] -= param_step;
      Eigen::Vector2d xy_plus;
      Eigen::Vector2d xy_minus;
      model_.Project(plus.data(), uv.x(), uv.y(), xy_plus.data());
      model_.Project(minus.data(), uv.x(), uv.y(), xy_minus.data());
      const Eigen::Vector2d numeric =
          (xy_plus - xy_minus) / (plus[i] - minus[i]);
      // Rounding of the difference of two pixel coordinates, see param_step.
      EXPECT_LT((jacobian.col(i) - numeric).norm(),
                1e-6 * jacobian.col(i).norm() + 2e-13 / param_step)
          << "ray " << uv.transpose() << ", parameter " << i;
    }
  }
}

// Residual and Jacobians by the chain rule of the solver (ray, depth, rotation)
// against those of COLMAP's bundle adjustment.
TEST_P(CameraModelTest, ReprojectionEqualsColmapsCostFunctions) {
  Random random({7});
  const size_t n = model_.NumParams();
  for (int trial = 0; trial < 20; ++trial) {
    Rigid3 pose;
    pose.rotation = RandomRotation(&random);
    const Eigen::Vector3d p(random.Uniform(-0.8, 0.8),
                            random.Uniform(-0.6, 0.6),
                            random.Uniform(2.0, 4.0));
    Eigen::Vector3d xyz = RandomVector(&random);
    pose.translation = p - pose.rotation * xyz;
    const Eigen::Vector2d observed(random.Uniform(0, 800),
                                   random.Uniform(0, 600));

    Eigen::Vector2d xy;
    Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
    Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> jacobian(2, n);
    model_.ProjectWithJacobian(params_.data(),
                               p.x() / p.z(),
                               p.y() / p.z(),
                               xy.data(),
                               jacobian_uv.data(),
                               jacobian.data());
    Eigen::Matrix<double, 2, 3> ray_jacobian;
    ray_jacobian << 1.0, 0.0, -p.x() / p.z(), 0.0, 1.0, -p.y() / p.z();
    const Eigen::Matrix<double, 2, 3> jacobian_point =
        jacobian_uv * ray_jacobian / p.z() * pose.rotation.toRotationMatrix();

    Eigen::Vector4d qvec(pose.rotation.w(),
                         pose.rotation.x(),
                         pose.rotation.y(),
                         pose.rotation.z());
    for (const bool constant_pose : {false, true}) {
      const std::unique_ptr<ceres::CostFunction> cost(
          constant_pose ? ColmapCost(model_, pose, observed)
                        : ColmapCost(model_, observed));
      Eigen::Vector2d residual;
      Eigen::Matrix<double, 2, 3, Eigen::RowMajor> colmap_point;
      Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> colmap_params(
          2, n);
      std::vector<const double*> blocks = {xyz.data(), params_.data()};
      std::vector<double*> jacobians = {colmap_point.data(),
                                        colmap_params.data()};
      if (!constant_pose) {
        blocks.insert(blocks.begin(), {qvec.data(), pose.translation.data()});
        jacobians.insert(jacobians.begin(), {nullptr, nullptr});
      }
      ASSERT_TRUE(
          cost->Evaluate(blocks.data(), residual.data(), jacobians.data()));
      EXPECT_LT((residual - (xy - observed)).norm(), 1e-9);
      EXPECT_LT((colmap_point - jacobian_point).norm(),
                1e-10 * jacobian_point.norm());
      EXPECT_LT((colmap_params - jacobian).norm(), 1e-10 * jacobian.norm());
    }
  }
}

TEST(CameraModels, ListsEveryModelOnceByIdentifier) {
  const std::vector<const CameraModel*> models = AllCameraModels();
  ASSERT_GE(models.size(), 11u);
  for (size_t i = 1; i < models.size(); ++i) {
    EXPECT_LT(CameraModelId(*models[i - 1]), CameraModelId(*models[i]));
  }
}

TEST(CameraModels, SaysWhyModelsOfOtherVersionsAreNotSupported) {
  const std::vector<std::pair<int, std::string>> of_colmap4 = {
      {11, "RAD_TAN_THIN_PRISM_FISHEYE"},
      {12, "SIMPLE_DIVISION"},
      {13, "DIVISION"},
      {14, "SIMPLE_FISHEYE"},
      {15, "FISHEYE"},
      {16, "EUCM"},
      {17, "EQUIRECTANGULAR"}};
  for (const auto& [id, name] : of_colmap4) {
    if (FindCameraModel(id) != nullptr) {
      EXPECT_EQ(FindCameraModel(id)->Name(), name);
      continue;
    }
    const std::optional<std::string> reason = WhyNotSupported(id);
    ASSERT_TRUE(reason) << name;
    EXPECT_NE(reason->find("the camera model " + name), std::string::npos);
    EXPECT_EQ(WhyNotSupported(name), reason);
  }
  EXPECT_FALSE(WhyNotSupported(18));
  EXPECT_FALSE(WhyNotSupported("PINHOLE_"));
}

TEST(CameraModels, UnknownModelsAreNotFound) {
  EXPECT_EQ(FindCameraModel(-1), nullptr);
  EXPECT_EQ(FindCameraModel(999), nullptr);
  EXPECT_EQ(FindCameraModel("opencv"), nullptr);
  EXPECT_EQ(FindCameraModel(""), nullptr);
}

}  // namespace
}  // namespace mfir
