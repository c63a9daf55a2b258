#include "fixed_extrinsics_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace mfir {
namespace {

constexpr size_t kMaxNumParams = 12;  // of COLMAP's camera models
constexpr size_t kPointsPerChunk = 256;
constexpr size_t kMaxChunkBytes = size_t{512} << 20;
// Damping as a factor on the diagonal of the normal equations; below the
// smallest value it is off.
constexpr double kInitialDamping = 1e-4;
constexpr double kMinDamping = 1e-9;
constexpr double kMaxDamping = 1e12;
// Of a standard normal variable.
constexpr double kMedianOfSquare = 0.45493642311957283;

using Matrix2x3 = Eigen::Matrix<double, 2, 3>;
using Jacobian =
    Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor, 2, kMaxNumParams>;
using ParamsBlock =
    Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, kMaxNumParams, 3>;

// An observation with everything needed to evaluate it.
struct FlatObservation {
  size_t camera_idx;
  Eigen::Vector2d xy;
};

struct FlatPoint {
  Eigen::Vector3d* xyz;
  double weight;  // of its frame
  size_t begin;   // into observations
  size_t end;
};

// Residual (px) and Jacobians of one observation.
struct Linearization {
  Eigen::Vector2d residual;
  Matrix2x3 jacobian_point;
  Jacobian jacobian_params;  // free parameters only
};

// A point's own normal equations.
struct PointSystem {
  Eigen::Vector3d gradient;
  Eigen::LLT<Eigen::Matrix3d> factorization;  // of the Hessian
  // By observation: Hessian and gradient with respect to the residual.
  std::vector<Eigen::Matrix2d> weights;
  std::vector<Eigen::Vector2d> weighted_residuals;
};

// Sums of one chunk of points: the reduced normal equations
// hessian * step = -gradient (lower triangle only), and the outer products of
// the tracks' gradients.
struct NormalEquations {
  Eigen::MatrixXd hessian;
  Eigen::VectorXd gradient;
  Eigen::MatrixXd gradient_outer;

  void SetZero(Eigen::Index size, bool with_outer) {
    hessian.setZero(size, size);
    gradient.setZero(size);
    if (with_outer) gradient_outer.setZero(size, size);
  }
};

bool ProjectPoint(const RigCamera& camera,
                  const Eigen::Matrix3d& rotation,
                  const std::vector<double>& params,
                  const Eigen::Vector3d& xyz,
                  Eigen::Vector2d* xy) {
  const Eigen::Vector3d p = rotation * xyz + camera.cam_from_world.translation;
  if (!(p.z() > std::numeric_limits<double>::epsilon())) {
    return false;
  }
  camera.model->Project(
      params.data(), p.x() / p.z(), p.y() / p.z(), xy->data());
  return xy->allFinite();
}

// How much of the second derivative of the loss is used. From one to the next,
// steps become shorter and the equations more often positive definite.
enum class Curvature { kNewton, kClamped, kReweighted };

// Hessian of 1/2 rho(|r|^2) with respect to r: rho' I + 2 rho'' r r^T. Along r
// it is rho' + 2 rho'' s, negative for outliers. kClamped: not below a share of
// rho'. kReweighted: rho' I (iterative reweighting, which never overshoots).
Eigen::Matrix2d RobustHessian(const Eigen::Vector2d& residual,
                              const double rho[3],
                              Curvature curvature) {
  constexpr double kMinShare = 0.05;
  Eigen::Matrix2d hessian = rho[1] * Eigen::Matrix2d::Identity();
  const double squared_norm = residual.squaredNorm();
  if (curvature == Curvature::kReweighted || !(squared_norm > 0.0)) {
    return hessian;
  }
  double second = 2.0 * rho[2];
  if (curvature == Curvature::kClamped) {
    second = std::max(second, (kMinShare - 1.0) * rho[1] / squared_norm);
  }
  return hessian + second * residual * residual.transpose();
}

// False for a point behind the camera.
bool LinearizeObservation(const RigCamera& camera,
                          const Eigen::Matrix3d& rotation,
                          const std::vector<double>& params,
                          const Eigen::Vector2d& observed_xy,
                          const std::vector<size_t>& free_idxs,
                          const Eigen::Vector3d& xyz,
                          Linearization* linearization) {
  const Eigen::Vector3d p = rotation * xyz + camera.cam_from_world.translation;
  if (!(p.z() > std::numeric_limits<double>::epsilon())) {
    return false;
  }
  const double inverse_depth = 1.0 / p.z();
  const double u = p.x() * inverse_depth;
  const double v = p.y() * inverse_depth;

  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
  double jacobian_params[2 * kMaxNumParams];
  camera.model->ProjectWithJacobian(
      params.data(), u, v, xy.data(), jacobian_uv.data(), jacobian_params);
  linearization->residual = xy - observed_xy;
  // d(u, v) / d(p) = [1 0 -u; 0 1 -v] / z.
  Matrix2x3 jacobian_cam;
  jacobian_cam << jacobian_uv * inverse_depth,
      -jacobian_uv * Eigen::Vector2d(u, v) * inverse_depth;
  linearization->jacobian_point = jacobian_cam * rotation;

  const size_t num_params = camera.model->NumParams();
  linearization->jacobian_params.resize(2, free_idxs.size());
  for (size_t i = 0; i < free_idxs.size(); ++i) {
    linearization->jacobian_params(0, i) = jacobian_params[free_idxs[i]];
    linearization->jacobian_params(1, i) =
        jacobian_params[num_params + free_idxs[i]];
  }
  return linearization->residual.allFinite();
}

std::vector<Eigen::Matrix3d> Rotations(const Scene& scene) {
  std::vector<Eigen::Matrix3d> rotations;
  for (const RigCamera& camera : scene.cameras) {
    rotations.push_back(camera.cam_from_world.rotation.toRotationMatrix());
  }
  return rotations;
}

class Solver {
 public:
  Solver(const FixedExtrinsicsOptions& options, Scene* scene);

  FixedExtrinsicsSummary Solve();

 private:
  using Params = std::vector<std::vector<double>>;  // by camera

  void CollectFreeParams();
  void CollectPoints();
  void SetPoints(const std::vector<Eigen::Vector3d>& new_xyz);
  void ComputePixelScales();

  // Cost of one point at `xyz`; infinite behind a camera.
  double PointCost(const FlatPoint& point,
                   const Params& params,
                   const Eigen::Vector3d& xyz) const;

  // False for a point behind a camera.
  bool LinearizePoint(const FlatPoint& point,
                      const Params& params,
                      const Eigen::Vector3d& xyz,
                      std::vector<Linearization>* linearizations) const;

  // Uses less curvature than asked for where the system is not positive
  // definite.
  void BuildPointSystem(const FlatPoint& point,
                        const std::vector<Linearization>& linearizations,
                        Curvature curvature,
                        double damping,
                        PointSystem* system) const;

  // Moves the point to the minimum of its cost; returns that.
  double RefinePoint(const FlatPoint& point,
                     const Params& params,
                     Eigen::Vector3d* xyz) const;

  // Adds one point, eliminated, to the reduced system; stores what
  // back-substitution needs.
  void EliminatePoint(size_t point_idx,
                      Curvature curvature,
                      NormalEquations* equations);
  NormalEquations BuildNormalEquations(Curvature curvature, bool with_outer);

  // Solves for the step of the intrinsics; false if the (damped) system is not
  // positive definite.
  bool ComputeStep(const NormalEquations& equations,
                   double damping,
                   Eigen::VectorXd* step) const;

  // Cost after the step. Each point takes its own step or stays, whichever is
  // better, and moves on to its minimum: what is left to minimize is a function
  // of the intrinsics alone.
  double TryStep(const Eigen::VectorXd& step,
                 const Params& new_params,
                 std::vector<Eigen::Vector3d>* new_xyz) const;
  Params AddStep(const Eigen::VectorXd& step) const;
  bool IsSmall(const Eigen::VectorXd& step, double* focal_change) const;
  void ComputeCovariance(FixedExtrinsicsSummary* summary);

  template <typename Function>
  void ParallelForChunks(const Function& function) const;

  const FixedExtrinsicsOptions options_;
  Scene* scene_;
  const std::vector<Eigen::Matrix3d> rotations_;
  std::vector<FlatObservation> observations_;
  std::vector<FlatPoint> points_;
  size_t chunk_size_ = 0;
  size_t num_chunks_ = 0;

  // By camera: parameter indices that are free, and where they start in the
  // reduced system.
  std::vector<std::vector<size_t>> free_idxs_;
  std::vector<Eigen::Index> offsets_;
  Eigen::Index num_free_ = 0;
  // By free parameter: pixels per unit at the image corner, and the focal
  // length of its camera.
  std::vector<double> pixel_scales_;
  std::vector<double> focal_lengths_;

  // Of the cameras, at the current iterate.
  Params current_params_;

  // Back-substitution: step_xyz = -(point_steps + sum_obs back_blocks^T step).
  std::vector<Eigen::Vector3d> point_steps_;
  std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>> back_blocks_;
};

Solver::Solver(const FixedExtrinsicsOptions& options, Scene* scene)
    : options_(options), scene_(scene), rotations_(Rotations(*scene)) {
  for (const RigCamera& camera : scene_->cameras) {
    current_params_.push_back(camera.params);
  }
  CollectPoints();
  CollectFreeParams();
  ComputePixelScales();

  // A fixed partition (independent of the number of threads) whose partial sums
  // are added in order makes the result reproducible.
  const size_t bytes_per_chunk =
      2 * sizeof(double) * static_cast<size_t>(num_free_ * num_free_) + 1;
  const size_t max_num_chunks =
      std::max<size_t>(2, kMaxChunkBytes / bytes_per_chunk);
  chunk_size_ = std::max(
      kPointsPerChunk, (points_.size() + max_num_chunks - 1) / max_num_chunks);
  num_chunks_ = (points_.size() + chunk_size_ - 1) / chunk_size_;

  back_blocks_.resize(observations_.size());
  for (size_t i = 0; i < observations_.size(); ++i) {
    back_blocks_[i].setZero(free_idxs_[observations_[i].camera_idx].size(), 3);
  }
}

void Solver::CollectPoints() {
  const std::vector<double> squared_residuals = SquaredResiduals(*scene_);
  size_t observation_idx = 0;
  for (size_t i = 0; i < scene_->frames.size(); ++i) {
    Frame& frame = scene_->frames[i];
    const double weight =
        options_.frame_weights.empty() ? 1.0 : options_.frame_weights[i];
    for (size_t j = 0; j < frame.points.size(); ++j) {
      const size_t begin = observations_.size();
      for (size_t k = frame.track_begins[j]; k < frame.track_begins[j + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        if (std::isfinite(squared_residuals[observation_idx++])) {
          observations_.push_back(
              {frame.images[observation.image_idx].camera_idx, observation.xy});
        }
      }
      if (observations_.size() - begin >= 2) {
        points_.push_back(
            {&frame.points[j], weight, begin, observations_.size()});
      } else {
        observations_.resize(begin);
      }
    }
  }
  point_steps_.assign(points_.size(), Eigen::Vector3d::Zero());
}

void Solver::SetPoints(const std::vector<Eigen::Vector3d>& new_xyz) {
  for (size_t i = 0; i < points_.size(); ++i) {
    *points_[i].xyz = new_xyz[i];
  }
}

void Solver::CollectFreeParams() {
  std::vector<bool> observed(scene_->cameras.size(), false);
  for (const FlatObservation& observation : observations_) {
    observed[observation.camera_idx] = true;
  }
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    offsets_.push_back(num_free_);
    free_idxs_.emplace_back();
    if (!observed[i]) continue;
    const CameraModel& model = *scene_->cameras[i].model;
    const auto add = [this](bool refine, const std::vector<size_t>& idxs) {
      if (refine) {
        free_idxs_.back().insert(
            free_idxs_.back().end(), idxs.begin(), idxs.end());
      }
    };
    add(options_.refine_focal_length, model.FocalLengthIdxs());
    add(options_.refine_principal_point, model.PrincipalPointIdxs());
    add(options_.refine_extra_params, model.ExtraParamsIdxs());
    std::sort(free_idxs_.back().begin(), free_idxs_.back().end());
    num_free_ += static_cast<Eigen::Index>(free_idxs_.back().size());
  }
}

void Solver::ComputePixelScales() {
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    const RigCamera& camera = scene_->cameras[i];
    if (free_idxs_[i].empty()) continue;
    double uv[2];
    double xy[2];
    double jacobian_uv[4];
    double jacobian_params[2 * kMaxNumParams];
    camera.model->Unproject(camera.params.data(),
                            static_cast<double>(camera.width),
                            static_cast<double>(camera.height),
                            uv);
    camera.model->ProjectWithJacobian(
        camera.params.data(), uv[0], uv[1], xy, jacobian_uv, jacobian_params);
    const size_t num_params = camera.model->NumParams();
    for (const size_t idx : free_idxs_[i]) {
      const double scale =
          std::hypot(jacobian_params[idx], jacobian_params[num_params + idx]);
      pixel_scales_.push_back(std::isfinite(scale) && scale > 0.0 ? scale
                                                                  : 1.0);
      focal_lengths_.push_back(
          camera.params[camera.model->FocalLengthIdxs()[0]]);
    }
  }
}

template <typename Function>
void Solver::ParallelForChunks(const Function& function) const {
  const long num_chunks = static_cast<long>(num_chunks_);
#pragma omp parallel for schedule(dynamic) num_threads(options_.num_threads)
  for (long chunk = 0; chunk < num_chunks; ++chunk) {
    const size_t begin = static_cast<size_t>(chunk) * chunk_size_;
    function(static_cast<size_t>(chunk),
             begin,
             std::min(points_.size(), begin + chunk_size_));
  }
}

double Solver::PointCost(const FlatPoint& point,
                         const Params& params,
                         const Eigen::Vector3d& xyz) const {
  double cost = 0.0;
  for (size_t i = point.begin; i < point.end; ++i) {
    const size_t camera_idx = observations_[i].camera_idx;
    Eigen::Vector2d xy;
    if (!ProjectPoint(scene_->cameras[camera_idx],
                      rotations_[camera_idx],
                      params[camera_idx],
                      xyz,
                      &xy)) {
      return std::numeric_limits<double>::infinity();
    }
    double rho[3];
    options_.loss->Evaluate((xy - observations_[i].xy).squaredNorm(), rho);
    cost += 0.5 * rho[0];
  }
  return point.weight * cost;
}

bool Solver::LinearizePoint(const FlatPoint& point,
                            const Params& params,
                            const Eigen::Vector3d& xyz,
                            std::vector<Linearization>* linearizations) const {
  linearizations->resize(point.end - point.begin);
  for (size_t i = point.begin; i < point.end; ++i) {
    const FlatObservation& observation = observations_[i];
    if (!LinearizeObservation(scene_->cameras[observation.camera_idx],
                              rotations_[observation.camera_idx],
                              params[observation.camera_idx],
                              observation.xy,
                              free_idxs_[observation.camera_idx],
                              xyz,
                              &(*linearizations)[i - point.begin])) {
      return false;
    }
  }
  return true;
}

void Solver::BuildPointSystem(const FlatPoint& point,
                              const std::vector<Linearization>& linearizations,
                              Curvature curvature,
                              double damping,
                              PointSystem* system) const {
  system->weights.resize(linearizations.size());
  system->weighted_residuals.resize(linearizations.size());
  Eigen::Matrix3d hessian;
  for (const Curvature tried_curvature :
       {Curvature::kNewton, Curvature::kClamped, Curvature::kReweighted}) {
    if (tried_curvature < curvature) continue;
    hessian.setZero();
    system->gradient.setZero();
    for (size_t i = 0; i < linearizations.size(); ++i) {
      const Eigen::Vector2d& residual = linearizations[i].residual;
      double rho[3];
      options_.loss->Evaluate(residual.squaredNorm(), rho);
      system->weights[i] =
          point.weight * RobustHessian(residual, rho, tried_curvature);
      system->weighted_residuals[i] = point.weight * rho[1] * residual;
      const Matrix2x3& jacobian = linearizations[i].jacobian_point;
      hessian += jacobian.transpose() * system->weights[i] * jacobian;
      system->gradient += jacobian.transpose() * system->weighted_residuals[i];
    }
    hessian.diagonal() *= 1.0 + damping;
    system->factorization.compute(hessian);
    if (system->factorization.info() == Eigen::Success) return;
  }
  // No information along some direction even with positive weights.
  hessian.diagonal().array() += std::max(1e-12 * hessian.trace(), 1e-300);
  system->factorization.compute(hessian);
}

double Solver::RefinePoint(const FlatPoint& point,
                           const Params& params,
                           Eigen::Vector3d* xyz) const {
  constexpr int kMaxNumIterations = 20;
  thread_local std::vector<Linearization> linearizations;
  thread_local PointSystem system;
  double cost = PointCost(point, params, *xyz);
  double damping = 0.0;
  bool moved = true;
  for (int i = 0; i < kMaxNumIterations && std::isfinite(cost); ++i) {
    if (moved) LinearizePoint(point, params, *xyz, &linearizations);
    BuildPointSystem(
        point, linearizations, Curvature::kNewton, damping, &system);
    const Eigen::Vector3d step = system.factorization.solve(system.gradient);
    const double expected_decrease = 0.5 * step.dot(system.gradient);
    const Eigen::Vector3d new_xyz = *xyz - step;
    const double new_cost = PointCost(point, params, new_xyz);
    moved = new_cost < cost;
    if (moved) {
      *xyz = new_xyz;
      cost = new_cost;
      damping *= 0.1;
    } else {
      damping = std::max(10.0 * damping, 1e-3);
    }
    if (!(expected_decrease > 1e-12 * cost)) break;
  }
  return cost;
}

void Solver::EliminatePoint(size_t point_idx,
                            Curvature curvature,
                            NormalEquations* equations) {
  const FlatPoint& point = points_[point_idx];
  const size_t track_length = point.end - point.begin;
  thread_local std::vector<Linearization> linearizations;
  thread_local std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>>
      blocks;
  linearizations.resize(track_length);
  blocks.resize(track_length);
  LinearizePoint(point, current_params_, *point.xyz, &linearizations);

  thread_local PointSystem system;
  BuildPointSystem(point, linearizations, curvature, 0.0, &system);
  const auto& weights = system.weights;
  const auto& weighted_residuals = system.weighted_residuals;

  point_steps_[point_idx] = system.factorization.solve(system.gradient);
  for (size_t i = 0; i < track_length; ++i) {
    blocks[i] = linearizations[i].jacobian_params.transpose() * weights[i] *
                linearizations[i].jacobian_point;
    back_blocks_[point.begin + i] =
        system.factorization.solve(blocks[i].transpose()).transpose();
  }
  for (size_t i = 0; i < track_length; ++i) {
    const size_t camera_i = observations_[point.begin + i].camera_idx;
    const Eigen::Index offset_i = offsets_[camera_i];
    const Jacobian& jacobian = linearizations[i].jacobian_params;
    const Eigen::Index size_i = jacobian.cols();
    if (size_i == 0) continue;
    equations->hessian.block(offset_i, offset_i, size_i, size_i) +=
        jacobian.transpose() * weights[i] * jacobian;
    equations->gradient.segment(offset_i, size_i) +=
        jacobian.transpose() * weighted_residuals[i] -
        blocks[i] * point_steps_[point_idx];
    for (size_t j = 0; j < track_length; ++j) {
      const Eigen::Index offset_j =
          offsets_[observations_[point.begin + j].camera_idx];
      const Eigen::Index size_j = linearizations[j].jacobian_params.cols();
      if (offset_j > offset_i || size_j == 0) continue;
      equations->hessian.block(offset_i, offset_j, size_i, size_j) -=
          back_blocks_[point.begin + i] * blocks[j].transpose();
    }
  }
  if (equations->gradient_outer.size() == 0) return;
  for (size_t i = 0; i < track_length; ++i) {
    const Eigen::Index offset_i =
        offsets_[observations_[point.begin + i].camera_idx];
    const Eigen::VectorXd gradient_i =
        linearizations[i].jacobian_params.transpose() * weighted_residuals[i];
    for (size_t j = 0; j < track_length; ++j) {
      const Eigen::Index offset_j =
          offsets_[observations_[point.begin + j].camera_idx];
      const Eigen::VectorXd gradient_j =
          linearizations[j].jacobian_params.transpose() * weighted_residuals[j];
      equations->gradient_outer.block(
          offset_i, offset_j, gradient_i.size(), gradient_j.size()) +=
          gradient_i * gradient_j.transpose();
    }
  }
}

NormalEquations Solver::BuildNormalEquations(Curvature curvature,
                                             bool with_outer) {
  std::vector<NormalEquations> chunks(num_chunks_);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    chunks[chunk].SetZero(num_free_, with_outer);
    for (size_t i = begin; i < end; ++i) {
      EliminatePoint(i, curvature, &chunks[chunk]);
    }
  });
  NormalEquations sum;
  sum.SetZero(num_free_, with_outer);
  for (const NormalEquations& chunk : chunks) {
    sum.hessian += chunk.hessian;
    sum.gradient += chunk.gradient;
    if (with_outer) sum.gradient_outer += chunk.gradient_outer;
  }
  return sum;
}

bool Solver::ComputeStep(const NormalEquations& equations,
                         double damping,
                         Eigen::VectorXd* step) const {
  // Unit diagonal: parameters of different units become comparable.
  const Eigen::VectorXd diagonal = equations.hessian.diagonal();
  const double max_diagonal = diagonal.maxCoeff();
  if (!(max_diagonal > 0.0) || !diagonal.allFinite()) {
    return false;
  }
  const Eigen::VectorXd scale =
      diagonal.cwiseMax(1e-14 * max_diagonal).cwiseSqrt().cwiseInverse();
  Eigen::MatrixXd scaled =
      scale.asDiagonal() *
      equations.hessian.selfadjointView<Eigen::Lower>().toDenseMatrix() *
      scale.asDiagonal();
  scaled.diagonal().array() += damping >= kMinDamping ? damping : 0.0;
  const Eigen::LLT<Eigen::MatrixXd> factorization(scaled);
  if (factorization.info() != Eigen::Success) {
    return false;
  }
  *step = -(scale.asDiagonal() *
            factorization.solve(scale.asDiagonal() * equations.gradient));
  return step->allFinite();
}

Solver::Params Solver::AddStep(const Eigen::VectorXd& step) const {
  Params params;
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    params.push_back(scene_->cameras[i].params);
    for (size_t j = 0; j < free_idxs_[i].size(); ++j) {
      params[i][free_idxs_[i][j]] += step(offsets_[i] + j);
    }
  }
  return params;
}

double Solver::TryStep(const Eigen::VectorXd& step,
                       const Params& new_params,
                       std::vector<Eigen::Vector3d>* new_xyz) const {
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    if (free_idxs_[i].empty()) continue;
    for (const size_t idx : scene_->cameras[i].model->FocalLengthIdxs()) {
      if (!(new_params[i][idx] > 0.0)) {
        return std::numeric_limits<double>::infinity();
      }
    }
  }
  std::vector<double> costs(num_chunks_, 0.0);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const FlatPoint& point = points_[i];
      Eigen::Vector3d& xyz = (*new_xyz)[i];
      xyz = *point.xyz - point_steps_[i];
      for (size_t k = point.begin; k < point.end; ++k) {
        const size_t camera_idx = observations_[k].camera_idx;
        xyz -=
            back_blocks_[k].transpose() *
            step.segment(offsets_[camera_idx], free_idxs_[camera_idx].size());
      }
      if (!(PointCost(point, new_params, xyz) <=
            PointCost(point, new_params, *point.xyz))) {
        xyz = *point.xyz;
      }
      costs[chunk] += RefinePoint(point, new_params, &xyz);
    }
  });
  double cost = 0.0;
  for (const double chunk_cost : costs) cost += chunk_cost;
  return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
}

bool Solver::IsSmall(const Eigen::VectorXd& step, double* focal_change) const {
  double max_change = 0.0;
  *focal_change = 0.0;
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    const std::vector<size_t>& focal_idxs =
        scene_->cameras[i].model == nullptr
            ? std::vector<size_t>()
            : scene_->cameras[i].model->FocalLengthIdxs();
    for (size_t j = 0; j < free_idxs_[i].size(); ++j) {
      const Eigen::Index k = offsets_[i] + static_cast<Eigen::Index>(j);
      if (std::count(focal_idxs.begin(), focal_idxs.end(), free_idxs_[i][j])) {
        *focal_change = std::max(
            *focal_change,
            std::abs(step(k)) / scene_->cameras[i].params[free_idxs_[i][j]]);
      }
      max_change = std::max(max_change,
                            std::abs(step(k)) *
                                std::min(pixel_scales_[k], focal_lengths_[k]) /
                                focal_lengths_[k]);
    }
  }
  return std::max(max_change, *focal_change) < options_.parameter_tolerance;
}

void Solver::ComputeCovariance(FixedExtrinsicsSummary* summary) {
  NormalEquations equations = BuildNormalEquations(Curvature::kNewton, true);
  const Eigen::VectorXd scale =
      equations.hessian.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const auto scaled_hessian = [&]() -> Eigen::MatrixXd {
    return scale.asDiagonal() *
           equations.hessian.selfadjointView<Eigen::Lower>().toDenseMatrix() *
           scale.asDiagonal();
  };
  Eigen::LLT<Eigen::MatrixXd> factorization(scaled_hessian());
  if (factorization.info() != Eigen::Success) {
    equations = BuildNormalEquations(Curvature::kReweighted, true);
    factorization.compute(scaled_hessian());
  }
  if (factorization.info() != Eigen::Success) {
    summary->covariance.setConstant(
        num_free_, num_free_, std::numeric_limits<double>::quiet_NaN());
  } else {
    const Eigen::MatrixXd half = factorization.solve(
        scale.asDiagonal() * equations.gradient_outer * scale.asDiagonal());
    summary->covariance = scale.asDiagonal() *
                          factorization.solve(half.transpose()) *
                          scale.asDiagonal();
  }

  // From free parameters to all parameters.
  std::vector<Eigen::Index> free_idxs;
  Eigen::Index num_params = 0;
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    for (const size_t idx : free_idxs_[i]) {
      free_idxs.push_back(num_params + static_cast<Eigen::Index>(idx));
    }
    num_params += static_cast<Eigen::Index>(scene_->cameras[i].params.size());
  }
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(num_params, num_params);
  for (Eigen::Index i = 0; i < num_free_; ++i) {
    for (Eigen::Index j = 0; j < num_free_; ++j) {
      covariance(free_idxs[i], free_idxs[j]) = summary->covariance(i, j);
    }
  }
  summary->covariance = std::move(covariance);
}

FixedExtrinsicsSummary Solver::Solve() {
  FixedExtrinsicsSummary summary;
  std::vector<Eigen::Vector3d> new_xyz(points_.size());
  // A step of zero: the points move to their minima.
  double cost =
      TryStep(Eigen::VectorXd::Zero(num_free_), current_params_, &new_xyz);
  SetPoints(new_xyz);
  summary.initial_cost = cost;
  summary.converged = num_free_ == 0;
  double damping = kInitialDamping;
  Curvature curvature = Curvature::kNewton;
  bool tried_undamped = false;
  while (!summary.converged &&
         summary.num_iterations < options_.max_num_iterations) {
    ++summary.num_iterations;
    const NormalEquations equations = BuildNormalEquations(curvature, false);
    Eigen::VectorXd step;
    if (!ComputeStep(equations, damping, &step)) {
      // Far from the solution the second derivative of the loss makes the
      // system indefinite; less of it cannot.
      if (curvature == Curvature::kNewton) {
        curvature = Curvature::kClamped;
      } else if ((damping *= 10.0) > kMaxDamping) {
        break;
      }
      continue;
    }
    const Params new_params = AddStep(step);
    const double new_cost = TryStep(step, new_params, &new_xyz);
    const bool small_step = IsSmall(step, &summary.last_focal_change);
    // Rounding limits what the cost can resolve.
    const bool accepted = new_cost <= cost * (1.0 + 1e-13);
    if (accepted) {
      summary.converged = small_step && damping < kMinDamping;
      current_params_ = new_params;
      for (size_t i = 0; i < scene_->cameras.size(); ++i) {
        scene_->cameras[i].params = new_params[i];
      }
      SetPoints(new_xyz);
      cost = new_cost;
      damping *= 0.03;
      curvature = Curvature::kNewton;
      tried_undamped = false;
    } else if (small_step && damping < kMinDamping) {
      // The cost cannot resolve the step.
      summary.converged = true;
    } else if (small_step && !tried_undamped) {
      tried_undamped = true;
      damping = 0.0;
    } else if (curvature != Curvature::kReweighted) {
      curvature = curvature == Curvature::kNewton ? Curvature::kClamped
                                                  : Curvature::kReweighted;
    } else {
      damping = std::max(10.0 * damping, kInitialDamping);
      if (damping > kMaxDamping) break;
    }
  }
  summary.final_cost = cost;
  if (options_.compute_covariance) {
    ComputeCovariance(&summary);
  }
  return summary;
}

}  // namespace

FixedExtrinsicsSummary SolveFixedExtrinsics(
    const FixedExtrinsicsOptions& options, Scene* scene) {
  return Solver(options, scene).Solve();
}

std::vector<double> SquaredResiduals(const Scene& scene) {
  const std::vector<Eigen::Matrix3d> rotations = Rotations(scene);
  std::vector<double> squared_residuals;
  for (const Frame& frame : scene.frames) {
    for (size_t i = 0; i < frame.points.size(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const size_t camera_idx =
            frame.images[observation.image_idx].camera_idx;
        const RigCamera& camera = scene.cameras[camera_idx];
        Eigen::Vector2d xy;
        squared_residuals.push_back(
            ProjectPoint(camera,
                         rotations[camera_idx],
                         camera.params,
                         frame.points[i],
                         &xy)
                ? (xy - observation.xy).squaredNorm()
                : std::numeric_limits<double>::infinity());
      }
    }
  }
  return squared_residuals;
}

std::vector<NoiseSample> NoiseSamples(const Scene& scene,
                                      const ceres::LossFunction* loss) {
  constexpr double kMinWeight = 0.05;
  const std::vector<Eigen::Matrix3d> rotations = Rotations(scene);
  double rho_at_zero[3] = {0.0, 1.0, 0.0};
  if (loss != nullptr) loss->Evaluate(0.0, rho_at_zero);
  std::vector<NoiseSample> samples;
  std::vector<Linearization> linearizations;
  std::vector<double> weights;
  for (const Frame& frame : scene.frames) {
    for (size_t i = 0; i < frame.points.size(); ++i) {
      linearizations.clear();
      weights.clear();
      Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const size_t camera_idx =
            frame.images[observation.image_idx].camera_idx;
        Linearization linearization;
        if (!LinearizeObservation(scene.cameras[camera_idx],
                                  rotations[camera_idx],
                                  scene.cameras[camera_idx].params,
                                  observation.xy,
                                  {},
                                  frame.points[i],
                                  &linearization)) {
          continue;
        }
        double rho[3] = {0.0, 1.0, 0.0};
        if (loss != nullptr) {
          loss->Evaluate(linearization.residual.squaredNorm(), rho);
        }
        weights.push_back(rho[1] / rho_at_zero[1]);
        linearizations.push_back(linearization);
        const Matrix2x3& jacobian = linearization.jacobian_point;
        information += weights.back() * jacobian.transpose() * jacobian;
      }
      if (linearizations.size() < 2) continue;
      const Eigen::LDLT<Eigen::Matrix3d> factorization(information);
      for (size_t k = 0; k < linearizations.size(); ++k) {
        const Matrix2x3& jacobian = linearizations[k].jacobian_point;
        const Eigen::Matrix2d covariance =
            Eigen::Matrix2d::Identity() -
            weights[k] * jacobian * factorization.solve(jacobian.transpose());
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen;
        eigen.computeDirect(covariance);
        for (int e = 0; e < 2; ++e) {
          const double weight = std::min(eigen.eigenvalues()(e), 1.0);
          if (!(weight > kMinWeight)) continue;
          const double residual =
              eigen.eigenvectors().col(e).dot(linearizations[k].residual);
          samples.push_back({residual * residual / weight, weight});
        }
      }
    }
  }
  return samples;
}

double RobustStd(std::vector<NoiseSample> samples) {
  std::sort(samples.begin(),
            samples.end(),
            [](const NoiseSample& a, const NoiseSample& b) {
              return a.squared < b.squared;
            });
  double total = 0.0;
  for (const NoiseSample& sample : samples) total += sample.weight;
  double sum = 0.0;
  for (const NoiseSample& sample : samples) {
    sum += sample.weight;
    if (sum >= 0.5 * total) {
      return std::sqrt(sample.squared / kMedianOfSquare);
    }
  }
  return 0.0;
}

}  // namespace mfir
