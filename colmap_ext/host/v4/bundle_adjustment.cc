#include "colmap_ext/host/bundle_adjustment.h"

#include <array>
#include <map>
#include <set>
#include <vector>

#include "colmap/estimators/bundle_adjustment_ceres.h"
#include "colmap/estimators/cost_functions/manifold.h"
#include "colmap/estimators/cost_functions/reprojection_error.h"
#include "colmap_ext/host/camera_models.h"

namespace mfir::host {
namespace {

// COLMAP's residual, whose pose is one block (x, y, z, w, translation), with
// two blocks.
template <typename Model>
class SplitPoseResidual {
 public:
  explicit SplitPoseResidual(const Eigen::Vector2d& xy) : functor_(xy) {}

  template <typename T>
  bool operator()(const T* const qvec,
                  const T* const tvec,
                  const T* const point,
                  const T* const params,
                  T* residuals) const {
    const T pose[7] = {
        qvec[1], qvec[2], qvec[3], qvec[0], tvec[0], tvec[1], tvec[2]};
    return functor_(point, pose, params, residuals);
  }

 private:
  const colmap::ReprojErrorCostFunctor<Model> functor_;
};

// The same for a pose that is no variable.
template <typename Model>
class ConstantPoseResidual {
 public:
  ConstantPoseResidual(const Rigid3& cam_from_world, const Eigen::Vector2d& xy)
      : pose_(colmap::Rigid3d(cam_from_world.rotation,
                              cam_from_world.translation)),
        functor_(xy) {}

  template <typename T>
  bool operator()(const T* const point,
                  const T* const params,
                  T* residuals) const {
    const Eigen::Matrix<T, 7, 1> pose = pose_.params.template cast<T>();
    return functor_(point, pose.data(), params, residuals);
  }

 private:
  const colmap::Rigid3d pose_;
  const colmap::ReprojErrorCostFunctor<Model> functor_;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Eigen::Vector2d& xy) {
  std::unique_ptr<ceres::CostFunction> cost_function;
  VisitCameraModels([&](auto model) {
    using Model = decltype(model);
    using Traits = CameraModelTraits<Model>;
    if (Traits::kModelId != model_id) return;
    using Residual = SplitPoseResidual<Model>;
    cost_function = std::make_unique<
        ceres::AutoDiffCostFunction<Residual, 2, 4, 3, 3, Traits::kNumParams>>(
        new Residual(xy));
  });
  return cost_function;
}

std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Rigid3& cam_from_world, const Eigen::Vector2d& xy) {
  std::unique_ptr<ceres::CostFunction> cost_function;
  VisitCameraModels([&](auto model) {
    using Model = decltype(model);
    using Traits = CameraModelTraits<Model>;
    if (Traits::kModelId != model_id) return;
    using Residual = ConstantPoseResidual<Model>;
    cost_function = std::make_unique<
        ceres::AutoDiffCostFunction<Residual, 2, 3, Traits::kNumParams>>(
        new Residual(cam_from_world, xy));
  });
  return cost_function;
}

// COLMAP 4's adjuster makes the problem of one reconstruction; ours has several
// and other terms besides, so only the residuals are COLMAP's.
struct BundleAdjuster::Impl {
  struct Pose {
    Reconstruction* reconstruction;
    image_t image_id;
    std::array<double, 4> rotation;  // w, x, y, z
    std::array<double, 3> translation;
  };

  BundleAdjustmentOptions options;
  ceres::Problem problem;
  std::set<camera_t> constant_cameras;
  std::map<std::pair<Reconstruction*, image_t>, Pose> poses;
  Reconstruction* reconstruction = nullptr;
  std::set<camera_t> camera_ids;  // of `reconstruction`, in the problem

  std::vector<int> ConstantParams(const Camera& camera) const {
    std::vector<int> idxs;
    const auto add = [&idxs](bool refine, const auto& group) {
      if (!refine) idxs.insert(idxs.end(), group.begin(), group.end());
    };
    add(options.refine_focal_length, camera.FocalLengthIdxs());
    add(options.refine_principal_point, camera.PrincipalPointIdxs());
    add(options.refine_extra_params, camera.ExtraParamsIdxs());
    return idxs;
  }
};

BundleAdjuster::BundleAdjuster(const BundleAdjustmentOptions& options)
    : impl_(std::make_unique<Impl>()) {
  impl_->options = options;
}

BundleAdjuster::~BundleAdjuster() = default;

ceres::Problem* BundleAdjuster::Problem() { return &impl_->problem; }

ceres::Solver::Options BundleAdjuster::SolverOptions() const {
  return colmap::CeresBundleAdjustmentOptions().solver_options;
}

void BundleAdjuster::SetConstantCamera(camera_t camera_id) {
  impl_->constant_cameras.insert(camera_id);
}

void BundleAdjuster::BeginReconstruction(Reconstruction* reconstruction) {
  impl_->reconstruction = reconstruction;
  impl_->camera_ids.clear();
}

BundleAdjuster::PoseBlocks BundleAdjuster::AddImage(image_t image_id,
                                                    ceres::LossFunction* loss) {
  const Image& image = impl_->reconstruction->Image(image_id);
  if (image.NumPoints3D() == 0) return {};
  Camera& camera = impl_->reconstruction->Camera(image.CameraId());
  const Rigid3 cam_from_world = CamFromWorld(image);
  const Eigen::Quaterniond q = cam_from_world.rotation.normalized();
  const Eigen::Vector3d& t = cam_from_world.translation;
  Impl::Pose& pose = impl_->poses[{impl_->reconstruction, image_id}];
  pose = {impl_->reconstruction,
          image_id,
          {q.w(), q.x(), q.y(), q.z()},
          {t.x(), t.y(), t.z()}};
  for (const Point2D& point2D : image.Points2D()) {
    if (!point2D.HasPoint3D()) continue;
    impl_->problem.AddResidualBlock(
        CreateReprojErrorCostFunction(ModelId(camera), point2D.xy).release(),
        loss,
        pose.rotation.data(),
        pose.translation.data(),
        impl_->reconstruction->Point3D(point2D.point3D_id).xyz.data(),
        camera.params.data());
  }
  impl_->problem.SetManifold(pose.rotation.data(),
                             new ceres::QuaternionManifold);
  impl_->camera_ids.insert(image.CameraId());
  return {pose.rotation.data(), pose.translation.data()};
}

void BundleAdjuster::EndReconstruction() {
  for (const camera_t camera_id : impl_->camera_ids) {
    Camera& camera = impl_->reconstruction->Camera(camera_id);
    const std::vector<int> constant = impl_->ConstantParams(camera);
    if (impl_->constant_cameras.count(camera_id) > 0 ||
        constant.size() == camera.params.size()) {
      impl_->problem.SetParameterBlockConstant(camera.params.data());
    } else if (!constant.empty()) {
      impl_->problem.SetManifold(
          camera.params.data(),
          new ceres::SubsetManifold(static_cast<int>(camera.params.size()),
                                    constant));
    }
  }
}

void BundleAdjuster::UpdatePoses() {
  for (const auto& [key, pose] : impl_->poses) {
    const auto& q = pose.rotation;
    const auto& t = pose.translation;
    SetCamFromWorld({Eigen::Quaterniond(q[0], q[1], q[2], q[3]),
                     Eigen::Vector3d(t[0], t[1], t[2])},
                    &pose.reconstruction->Image(pose.image_id));
  }
}

bool AdjustPosesAndPoints(Reconstruction* reconstruction) {
  colmap::BundleAdjustmentOptions options;
  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  options.print_summary = false;
  options.ceres->loss_function_type =
      colmap::CeresBundleAdjustmentOptions::LossFunctionType::CAUCHY;
  ceres::Solver::Options& solver_options = options.ceres->solver_options;
  solver_options.function_tolerance = 1e-6;
  solver_options.max_num_iterations = 50;
  solver_options.logging_type = ceres::SILENT;
  solver_options.num_threads = 1;
  // Unlike CHOLMOD this needs no BLAS, which has threads of its own.
  solver_options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  colmap::BundleAdjustmentConfig config;
  for (const image_t image_id : reconstruction->RegImageIds()) {
    config.AddImage(image_id);
  }
  config.FixGauge(colmap::BundleAdjustmentGauge::TWO_CAMS_FROM_WORLD);
  const auto bundle_adjuster =
      colmap::CreateDefaultBundleAdjuster(options, config, *reconstruction);
  return bundle_adjuster->Solve()->IsSolutionUsable();
}

double* ParamsData(camera_t camera_id, Reconstruction* reconstruction) {
  return reconstruction->Camera(camera_id).params.data();
}

}  // namespace mfir::host
