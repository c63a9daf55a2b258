#include "colmap_ext/host/bundle_adjustment.h"

#include "base/camera_models.h"
#include "base/cost_functions.h"
#include "optim/bundle_adjustment.h"

namespace mfir::host {

std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Eigen::Vector2d& xy) {
  using namespace colmap;  // NOLINT: the list of cases is COLMAP's
  ceres::CostFunction* cost_function = nullptr;
  switch (model_id) {
#define CAMERA_MODEL_CASE(Model)                                     \
  case Model::kModelId:                                              \
    cost_function = BundleAdjustmentCostFunction<Model>::Create(xy); \
    break;
    CAMERA_MODEL_CASES
#undef CAMERA_MODEL_CASE
  }
  return std::unique_ptr<ceres::CostFunction>(cost_function);
}

std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Rigid3& cam_from_world, const Eigen::Vector2d& xy) {
  using namespace colmap;  // NOLINT: the list of cases is COLMAP's
  const Eigen::Quaterniond& q = cam_from_world.rotation;
  const Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
  ceres::CostFunction* cost_function = nullptr;
  switch (model_id) {
#define CAMERA_MODEL_CASE(Model)                                             \
  case Model::kModelId:                                                      \
    cost_function = BundleAdjustmentConstantPoseCostFunction<Model>::Create( \
        qvec, cam_from_world.translation, xy);                               \
    break;
    CAMERA_MODEL_CASES
#undef CAMERA_MODEL_CASE
  }
  return std::unique_ptr<ceres::CostFunction>(cost_function);
}

// Uses COLMAP's functions that set up a problem; the patch makes them
// protected.
struct BundleAdjuster::Impl : public colmap::BundleAdjuster {
  static colmap::BundleAdjustmentOptions ToColmap(
      const BundleAdjustmentOptions& options) {
    colmap::BundleAdjustmentOptions colmap_options;
    colmap_options.refine_focal_length = options.refine_focal_length;
    colmap_options.refine_principal_point = options.refine_principal_point;
    colmap_options.refine_extra_params = options.refine_extra_params;
    return colmap_options;
  }

  explicit Impl(const BundleAdjustmentOptions& options)
      : colmap::BundleAdjuster(ToColmap(options),
                               colmap::BundleAdjustmentConfig()) {
    problem_ = std::make_unique<ceres::Problem>();
  }

  PoseBlocks AddImage(image_t image_id, ceres::LossFunction* loss) {
    AddImageToProblem(image_id, reconstruction, loss);
    colmap::Image& image = reconstruction->Image(image_id);
    if (camera_ids_.count(image.CameraId()) == 0) return {};
    return {image.Qvec().data(), image.Tvec().data()};
  }

  using colmap::BundleAdjuster::camera_ids_;
  using colmap::BundleAdjuster::config_;
  using colmap::BundleAdjuster::ParameterizeCameras;
  using colmap::BundleAdjuster::point3D_num_observations_;
  using colmap::BundleAdjuster::problem_;

  Reconstruction* reconstruction = nullptr;
};

BundleAdjuster::BundleAdjuster(const BundleAdjustmentOptions& options)
    : impl_(std::make_unique<Impl>(options)) {}

BundleAdjuster::~BundleAdjuster() = default;

ceres::Problem* BundleAdjuster::Problem() { return impl_->problem_.get(); }

ceres::Solver::Options BundleAdjuster::SolverOptions() const {
  return colmap::BundleAdjustmentOptions().solver_options;
}

void BundleAdjuster::SetConstantCamera(camera_t camera_id) {
  impl_->config_.SetConstantCamera(camera_id);
}

void BundleAdjuster::BeginReconstruction(Reconstruction* reconstruction) {
  impl_->reconstruction = reconstruction;
  impl_->camera_ids_.clear();
  impl_->point3D_num_observations_.clear();
}

BundleAdjuster::PoseBlocks BundleAdjuster::AddImage(image_t image_id,
                                                    ceres::LossFunction* loss) {
  return impl_->AddImage(image_id, loss);
}

void BundleAdjuster::EndReconstruction() {
  impl_->ParameterizeCameras(impl_->reconstruction);
}

// The blocks are those of the images.
void BundleAdjuster::UpdatePoses() {}

bool AdjustPosesAndPoints(Reconstruction* reconstruction) {
  colmap::BundleAdjustmentOptions options;
  options.loss_function_type =
      colmap::BundleAdjustmentOptions::LossFunctionType::CAUCHY;
  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  options.print_summary = false;
  options.solver_options.function_tolerance = 1e-6;
  options.solver_options.max_num_iterations = 50;
  options.solver_options.logging_type = ceres::SILENT;
  options.solver_options.num_threads = 1;
  // Unlike CHOLMOD this needs no BLAS, which has threads of its own.
  options.solver_options.sparse_linear_algebra_library_type =
      ceres::EIGEN_SPARSE;
  const std::vector<image_t> image_ids = reconstruction->RegImageIds();
  colmap::BundleAdjustmentConfig config;
  for (const image_t image_id : image_ids) config.AddImage(image_id);
  // Fixes the gauge.
  config.SetConstantPose(image_ids[0]);
  config.SetConstantTvec(image_ids[1], {0});
  colmap::BundleAdjuster bundle_adjuster(options, config);
  return bundle_adjuster.Solve(reconstruction) &&
         bundle_adjuster.Summary().IsSolutionUsable();
}

double* ParamsData(camera_t camera_id, Reconstruction* reconstruction) {
  return reconstruction->Camera(camera_id).ParamsData();
}

}  // namespace mfir::host
