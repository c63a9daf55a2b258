#include "fixed_extrinsics_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Dense>
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

class Solver {
 public:
  Solver(const FixedExtrinsicsOptions& options, Scene* scene);

  FixedExtrinsicsSummary Solve();

 private:
  using Params = std::vector<std::vector<double>>;  // by camera

  void CollectFreeParams();
  void CollectPoints();
  void ComputePixelScales();

  // Cost of one point at `xyz`; infinite behind a camera.
  double PointCost(const FlatPoint& point,
                   const Params& params,
                   const Eigen::Vector3d& xyz) const;
  double Cost() const;

  void Linearize(const FlatObservation& observation,
                 const Eigen::Vector3d& xyz,
                 Linearization* linearization) const;

  // Adds one point, eliminated, to the reduced system; stores what
  // back-substitution needs. With `full_newton` the second derivative of the
  // loss is used as far as the point's own block stays positive definite.
  void EliminatePoint(size_t point_idx,
                      bool full_newton,
                      NormalEquations* equations);
  NormalEquations BuildNormalEquations(bool full_newton, bool with_outer);

  // Solves for the step of the intrinsics; false if the (damped) system is not
  // positive definite.
  bool ComputeStep(const NormalEquations& equations,
                   double damping,
                   Eigen::VectorXd* step) const;

  // Cost after the step. Each point takes its own step or stays, whichever is
  // better; xyz get the result.
  double TryStep(const Eigen::VectorXd& step,
                 const Params& new_params,
                 std::vector<Eigen::Vector3d>* new_xyz,
                 std::vector<bool>* point_moved) const;
  Params AddStep(const Eigen::VectorXd& step) const;
  bool IsSmall(const Eigen::VectorXd& step, double* focal_change) const;
  void ComputeCovariance(FixedExtrinsicsSummary* summary);

  template <typename Function>
  void ParallelForChunks(const Function& function) const;

  const FixedExtrinsicsOptions options_;
  Scene* scene_;
  std::vector<Eigen::Matrix3d> rotations_;
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

  // Back-substitution: step_xyz = -(point_steps + sum_obs back_blocks^T step).
  std::vector<Eigen::Vector3d> point_steps_;
  std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>> back_blocks_;
  std::vector<double> point_damping_;
};

Solver::Solver(const FixedExtrinsicsOptions& options, Scene* scene)
    : options_(options), scene_(scene) {
  for (const RigCamera& camera : scene_->cameras) {
    rotations_.push_back(camera.cam_from_world.rotation.toRotationMatrix());
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
  point_steps_.resize(points_.size());
  point_damping_.assign(points_.size(), kInitialDamping);
  back_blocks_.resize(observations_.size());
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

double Solver::Cost() const {
  Params params;
  for (const RigCamera& camera : scene_->cameras) {
    params.push_back(camera.params);
  }
  std::vector<double> costs(num_chunks_, 0.0);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      costs[chunk] += PointCost(points_[i], params, *points_[i].xyz);
    }
  });
  double cost = 0.0;
  for (const double chunk_cost : costs) cost += chunk_cost;
  return cost;
}

void Solver::Linearize(const FlatObservation& observation,
                       const Eigen::Vector3d& xyz,
                       Linearization* linearization) const {
  const RigCamera& camera = scene_->cameras[observation.camera_idx];
  const Eigen::Matrix3d& rotation = rotations_[observation.camera_idx];
  const Eigen::Vector3d p = rotation * xyz + camera.cam_from_world.translation;
  const double inverse_depth = 1.0 / p.z();
  const double u = p.x() * inverse_depth;
  const double v = p.y() * inverse_depth;

  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
  double jacobian_params[2 * kMaxNumParams];
  camera.model->ProjectWithJacobian(camera.params.data(),
                                    u,
                                    v,
                                    xy.data(),
                                    jacobian_uv.data(),
                                    jacobian_params);
  linearization->residual = xy - observation.xy;
  // d(u, v) / d(p) = [1 0 -u; 0 1 -v] / z.
  Matrix2x3 jacobian_cam;
  jacobian_cam << jacobian_uv * inverse_depth,
      -jacobian_uv * Eigen::Vector2d(u, v) * inverse_depth;
  linearization->jacobian_point = jacobian_cam * rotation;

  const std::vector<size_t>& free_idxs = free_idxs_[observation.camera_idx];
  const size_t num_params = camera.model->NumParams();
  linearization->jacobian_params.resize(2, free_idxs.size());
  for (size_t i = 0; i < free_idxs.size(); ++i) {
    linearization->jacobian_params(0, i) = jacobian_params[free_idxs[i]];
    linearization->jacobian_params(1, i) =
        jacobian_params[num_params + free_idxs[i]];
  }
}

void Solver::EliminatePoint(size_t point_idx,
                            bool full_newton,
                            NormalEquations* equations) {
  const FlatPoint& point = points_[point_idx];
  const size_t track_length = point.end - point.begin;
  thread_local std::vector<Linearization> linearizations;
  thread_local std::vector<Eigen::Matrix2d> weights;
  thread_local std::vector<Eigen::Vector2d> weighted_residuals;
  thread_local std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>>
      blocks;
  linearizations.resize(track_length);
  weights.resize(track_length);
  weighted_residuals.resize(track_length);
  blocks.resize(track_length);
  for (size_t i = 0; i < track_length; ++i) {
    Linearize(observations_[point.begin + i], *point.xyz, &linearizations[i]);
  }

  // Hessian of 1/2 rho(|r|^2) with respect to r: rho' I + 2 rho'' r r^T. The
  // second part is negative for robust losses; without it (iterative
  // reweighting) every block is positive semi-definite.
  Eigen::Matrix3d hessian_point;
  Eigen::Vector3d gradient_point;
  Eigen::LLT<Eigen::Matrix3d> factorization;
  for (const bool second_order : {true, false}) {
    if (second_order && !full_newton) continue;
    hessian_point.setZero();
    gradient_point.setZero();
    for (size_t i = 0; i < track_length; ++i) {
      const Eigen::Vector2d& residual = linearizations[i].residual;
      double rho[3];
      options_.loss->Evaluate(residual.squaredNorm(), rho);
      weights[i] = point.weight * rho[1] * Eigen::Matrix2d::Identity();
      if (second_order) {
        weights[i] +=
            point.weight * 2.0 * rho[2] * residual * residual.transpose();
      }
      weighted_residuals[i] = point.weight * rho[1] * residual;
      const Matrix2x3& jacobian = linearizations[i].jacobian_point;
      hessian_point += jacobian.transpose() * weights[i] * jacobian;
      gradient_point += jacobian.transpose() * weighted_residuals[i];
    }
    const double damping = point_damping_[point_idx];
    if (damping >= kMinDamping) {
      hessian_point.diagonal() *= 1.0 + damping;
    }
    factorization.compute(hessian_point);
    if (factorization.info() == Eigen::Success) break;
  }
  if (factorization.info() != Eigen::Success) {
    // No information along some direction even with positive weights.
    hessian_point.diagonal().array() +=
        std::max(1e-12 * hessian_point.trace(), 1e-300);
    factorization.compute(hessian_point);
  }

  point_steps_[point_idx] = factorization.solve(gradient_point);
  for (size_t i = 0; i < track_length; ++i) {
    blocks[i] = linearizations[i].jacobian_params.transpose() * weights[i] *
                linearizations[i].jacobian_point;
    back_blocks_[point.begin + i] =
        factorization.solve(blocks[i].transpose()).transpose();
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

NormalEquations Solver::BuildNormalEquations(bool full_newton,
                                             bool with_outer) {
  std::vector<NormalEquations> chunks(num_chunks_);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    chunks[chunk].SetZero(num_free_, with_outer);
    for (size_t i = begin; i < end; ++i) {
      EliminatePoint(i, full_newton, &chunks[chunk]);
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
                       std::vector<Eigen::Vector3d>* new_xyz,
                       std::vector<bool>* point_moved) const {
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    if (free_idxs_[i].empty()) continue;
    for (const size_t idx : scene_->cameras[i].model->FocalLengthIdxs()) {
      if (!(new_params[i][idx] > 0.0)) {
        return std::numeric_limits<double>::infinity();
      }
    }
  }
  std::vector<double> costs(num_chunks_, 0.0);
  std::vector<char> moved(points_.size(), 1);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const FlatPoint& point = points_[i];
      Eigen::Vector3d xyz_step = -point_steps_[i];
      for (size_t k = point.begin; k < point.end; ++k) {
        const size_t camera_idx = observations_[k].camera_idx;
        xyz_step -=
            back_blocks_[k].transpose() *
            step.segment(offsets_[camera_idx], free_idxs_[camera_idx].size());
      }
      (*new_xyz)[i] = *point.xyz + xyz_step;
      double cost = PointCost(point, new_params, (*new_xyz)[i]);
      const double cost_of_staying = PointCost(point, new_params, *point.xyz);
      if (!(cost <= cost_of_staying)) {
        // Staying is no answer where the step is just rounding noise.
        moved[i] = cost <= cost_of_staying * (1.0 + 1e-12);
        cost = cost_of_staying;
        (*new_xyz)[i] = *point.xyz;
      }
      costs[chunk] += cost;
    }
  });
  point_moved->assign(moved.begin(), moved.end());
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
  std::fill(point_damping_.begin(), point_damping_.end(), 0.0);
  NormalEquations equations = BuildNormalEquations(true, true);
  const Eigen::VectorXd scale =
      equations.hessian.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const auto scaled_hessian = [&]() -> Eigen::MatrixXd {
    return scale.asDiagonal() *
           equations.hessian.selfadjointView<Eigen::Lower>().toDenseMatrix() *
           scale.asDiagonal();
  };
  Eigen::LLT<Eigen::MatrixXd> factorization(scaled_hessian());
  if (factorization.info() != Eigen::Success) {
    equations = BuildNormalEquations(false, true);
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
  double cost = Cost();
  summary.initial_cost = cost;
  double damping = kInitialDamping;
  bool full_newton = true;
  std::vector<Eigen::Vector3d> new_xyz(points_.size());
  std::vector<bool> point_moved;
  for (; summary.num_iterations < options_.max_num_iterations;
       ++summary.num_iterations) {
    const NormalEquations equations = BuildNormalEquations(full_newton, false);
    Eigen::VectorXd step;
    if (num_free_ == 0) {
      step.resize(0);
    } else if (!ComputeStep(equations, damping, &step)) {
      // Far from the solution the second derivative of the loss makes the
      // system indefinite; reweighting alone cannot.
      if (full_newton) {
        full_newton = false;
      } else if ((damping *= 10.0) > kMaxDamping) {
        break;
      }
      continue;
    }
    const Params new_params = AddStep(step);
    const double new_cost = TryStep(step, new_params, &new_xyz, &point_moved);
    const bool small_step = IsSmall(step, &summary.last_focal_change);
    // Rounding limits what the cost can resolve.
    const bool accepted = new_cost <= cost * (1.0 + 1e-13);
    if (accepted) {
      const bool cost_converged = cost - new_cost <= 1e-13 * cost;
      for (size_t i = 0; i < scene_->cameras.size(); ++i) {
        scene_->cameras[i].params = new_params[i];
      }
      for (size_t i = 0; i < points_.size(); ++i) {
        *points_[i].xyz = new_xyz[i];
        double& point_damping = point_damping_[i];
        point_damping = point_moved[i]
                            ? 0.1 * point_damping
                            : std::max(10.0 * point_damping, kInitialDamping);
      }
      cost = new_cost;
      const bool undamped = damping < kMinDamping;
      damping *= 0.1;
      full_newton = true;
      if (undamped && small_step && (num_free_ > 0 || cost_converged)) {
        summary.converged = true;
        ++summary.num_iterations;
        break;
      }
    } else if (full_newton) {
      full_newton = false;
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
  std::vector<Eigen::Matrix3d> rotations;
  for (const RigCamera& camera : scene.cameras) {
    rotations.push_back(camera.cam_from_world.rotation.toRotationMatrix());
  }
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

std::vector<double> NoiseSamples(const Scene& scene,
                                 const std::vector<double>& squared_residuals) {
  std::vector<double> samples;
  // Two views leave one of four degrees of freedom: a last resort.
  for (const size_t min_track_length : {3, 2}) {
    size_t observation_idx = 0;
    for (const Frame& frame : scene.frames) {
      for (size_t i = 0; i < frame.points.size(); ++i) {
        const size_t length = frame.track_begins[i + 1] - frame.track_begins[i];
        const double share = 1.0 - 3.0 / (2.0 * static_cast<double>(length));
        for (size_t k = 0; k < length; ++k) {
          const double s = squared_residuals[observation_idx++];
          if (length >= min_track_length && std::isfinite(s)) {
            samples.push_back(s / share);
          }
        }
      }
    }
    if (!samples.empty()) break;
  }
  return samples;
}

}  // namespace mfir
