#include "src/patches/patch_slope.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include <Eigen/Cholesky>

#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

// Tilts of the grid: tangents of the angle, and how many directions of each.
struct TiltRing {
  double tangent;
  int num_directions;
};
constexpr TiltRing kTiltRings[] = {{0.45, 8}, {0.9, 12}, {1.6, 12}};
constexpr size_t kNumTiltRings = std::size(kTiltRings);
// Mean likeness from which no steeper tilts are tried.
constexpr double kGoodLikeness = 0.95;

constexpr int kMaxNumIterations = 6;
constexpr double kTiltTolerance = 0.005;
constexpr double kMaxTilt = 2.5;       // tangent
constexpr double kPriorTilt = 1.0;     // standard deviation, tangent
constexpr double kMaxMove = 2.0;       // px
constexpr double kMinLikeness = 0.3;   // of a view that takes part
constexpr double kMinVariance = 0.01;  // of the noise, relative to the patch

// The affine part of the fit, of whose 4 numbers a slope explains 2.
using Vector4d = Eigen::Vector4d;

// What one view says at its present position, relative to the gain.
struct ViewFit {
  bool valid = false;
  Eigen::Vector2d translation;
  Vector4d affine;
  double noise_variance = 1.0;
  double likeness = 0.0;
};

// Says which slopes it wants to try, until it is done.
class SlopeEstimator {
 public:
  explicit SlopeEstimator(SlopeProblem* problem)
      : problem_(*problem), facing_(problem->reference->FacingSlope()) {
    const Eigen::Map<
        const Eigen::
            Matrix<float, kNumPatchBasis, kNumPatchBasis, Eigen::RowMajor>>
        inverse(problem->patch->inverse);
    affine_information_ = inverse.block<4, 4>(2, 2).cast<double>().inverse();
    translation_by_affine_ =
        inverse.block<2, 4>(0, 2).cast<double>() * affine_information_;
    // Slopes are about tangents times the size of a pixel on the ray.
    const Eigen::Matrix2d tangent_from_slope =
        problem->reference->ray_jacobian.transpose().inverse() *
        problem->reference->Ray().squaredNorm();
    slope_information_ = tangent_from_slope.transpose() * tangent_from_slope;
    positions_.resize(2, static_cast<Eigen::Index>(NumViews()));
    for (size_t i = 0; i < NumViews(); ++i) {
      Position(i) = problem->views[i].xy;
    }
    problem->slope = facing_;
    Try(facing_);
  }

  bool IsDone() const { return stage_ == Stage::kDone; }

  // Each slope to try in each view.
  size_t NumJobs() const {
    return IsDone() ? 0 : static_cast<size_t>(trials_.cols()) * NumViews();
  }

  void MakeJobs(PatchJob* jobs) const {
    for (Eigen::Index k = 0; k < trials_.cols(); ++k) {
      for (size_t i = 0; i < NumViews(); ++i) *jobs++ = MakeJob(i, Trial(k));
    }
  }

  // The results of the jobs.
  void Take(const PatchFit* fits) {
    switch (stage_) {
      case Stage::kGrid:
        TakeGrid(fits);
        break;
      case Stage::kIterations:
        Iterate(fits);
        break;
      case Stage::kResult:
        if (MeanLikeness(fits) >= best_likeness_) problem_.slope = Trial(0);
        stage_ = Stage::kDone;
        break;
      case Stage::kDone:
        break;
    }
  }

 private:
  enum class Stage { kGrid, kIterations, kResult, kDone };

  size_t NumViews() const { return problem_.views.size(); }
  Eigen::Matrix2Xd::ColXpr Position(size_t view_idx) {
    return positions_.col(static_cast<Eigen::Index>(view_idx));
  }
  Eigen::Vector2d Position(size_t view_idx) const {
    return positions_.col(static_cast<Eigen::Index>(view_idx));
  }
  Eigen::Vector2d Trial(Eigen::Index i) const { return trials_.col(i); }
  void Try(const Eigen::Vector2d& slope) { trials_ = slope; }

  PatchJob MakeJob(size_t view_idx, const Eigen::Vector2d& slope) const {
    const SlopeView& view = problem_.views[view_idx];
    const Eigen::Matrix2d affine = view.map.Affine(slope);
    const Eigen::Vector2d xy = Position(view_idx);
    PatchJob job = {static_cast<int>(problem_.template_idx),
                    static_cast<int>(view.image_idx),
                    {{xy.x(), xy.y()},
                     {static_cast<float>(affine(0, 0)),
                      static_cast<float>(affine(0, 1)),
                      static_cast<float>(affine(1, 0)),
                      static_cast<float>(affine(1, 1))},
                     {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}}};
    const float* a = job.warp.affine;
    if (a[0] * a[3] - a[1] * a[2] <= 0.0f) {
      // A mirrored patch is seen nowhere: outside of every image.
      job.warp.center[0] = std::numeric_limits<double>::quiet_NaN();
    }
    return job;
  }

  ViewFit Assess(const PatchFit& fit) const {
    ViewFit result;
    const Eigen::Map<const Eigen::Matrix<float, kNumPatchBasis, 1>> c(
        fit.coefficients);
    if (!(c(kGainIdx) > 0.0f)) return result;
    const double inverse_gain = 1.0 / c(kGainIdx);
    result.translation = inverse_gain * c.head<2>().cast<double>();
    result.affine = inverse_gain * c.segment<4>(2).cast<double>();
    result.noise_variance = std::max<double>(fit.noise_variance, kMinVariance);
    // Share of the patch's variance that a shift explains, with the shape as it
    // is.
    const double squared =
        (kNumPatchSamples - kNumPatchBasis) * result.noise_variance +
        result.affine.dot(affine_information_ * result.affine);
    result.likeness = 1.0 / (1.0 + squared / kNumPatchSamples);
    result.valid = result.likeness > kMinLikeness;
    return result;
  }

  // Over the views of one trial.
  double MeanLikeness(const PatchFit* fits) const {
    double sum = 0.0;
    for (size_t i = 0; i < NumViews(); ++i) {
      const ViewFit fit = Assess(fits[i]);
      sum += fit.valid ? fit.likeness : 0.0;
    }
    return sum / std::max<double>(static_cast<double>(NumViews()), 1.0);
  }

  // The facing slope, then ring by ring until one fits well.
  void TakeGrid(const PatchFit* fits) {
    for (Eigen::Index k = 0; k < trials_.cols(); ++k) {
      const double likeness =
          MeanLikeness(fits + static_cast<size_t>(k) * NumViews());
      if (likeness > best_likeness_) {
        problem_.slope = Trial(k);
        best_likeness_ = likeness;
      }
    }
    if (next_ring_ == kNumTiltRings || best_likeness_ >= kGoodLikeness) {
      stage_ = Stage::kIterations;
      Try(problem_.slope);
    } else {
      TryRing(kTiltRings[next_ring_++]);
    }
  }

  void TryRing(const TiltRing& ring) {
    trials_.resize(2, ring.num_directions);
    for (int i = 0; i < ring.num_directions; ++i) {
      const double angle = 2.0 * M_PI * i / ring.num_directions;
      trials_.col(i) = SlopeOfTilt(
          *problem_.reference,
          ring.tangent * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
    }
  }

  // The 4 affine numbers by the slope: a change of inverse depth moves the
  // patch along the epipolar line, here in pixels of the reference image.
  Eigen::Matrix<double, 4, 2> AffineBySlope(
      size_t view_idx, const Eigen::Vector2d& slope) const {
    const PatchMap& map = problem_.views[view_idx].map;
    const Eigen::Vector2d e =
        kPatchRadius * (map.Affine(slope).inverse() * map.epipole);
    Eigen::Matrix<double, 4, 2> result;
    result << e.x(), 0.0, 0.0, e.x(), e.y(), 0.0, 0.0, e.y();
    return result;
  }

  // One step of Gauss-Newton from the slope that was tried.
  void Iterate(const PatchFit* patch_fits) {
    Eigen::Vector2d slope = Trial(0);
    Eigen::Matrix2d information =
        slope_information_ / (kPriorTilt * kPriorTilt);
    Eigen::Vector2d gradient = information * (slope - facing_);
    std::vector<ViewFit> fits;
    std::vector<Eigen::Matrix<double, 4, 2>> jacobians;
    for (size_t i = 0; i < NumViews(); ++i) {
      fits.push_back(Assess(patch_fits[i]));
      jacobians.push_back(AffineBySlope(i, slope));
      if (!fits[i].valid) continue;
      const Eigen::Matrix<double, 2, 4> weighted = jacobians[i].transpose() *
                                                   affine_information_ /
                                                   fits[i].noise_variance;
      information += weighted * jacobians[i];
      gradient += weighted * fits[i].affine;
    }
    // The fit tells how far the warp is from the patch: it moves back.
    const Eigen::Vector2d step = information.ldlt().solve(gradient);
    if (!step.allFinite()) {
      stage_ = Stage::kResult;
      return;
    }
    for (size_t i = 0; i < NumViews(); ++i) {
      if (fits[i].valid) MoveView(i, slope, fits[i], jacobians[i] * step);
    }
    slope -= step;
    const double tilt = std::sqrt(
        (slope - facing_).dot(slope_information_ * (slope - facing_)));
    if (tilt > kMaxTilt) {
      slope = facing_ + (slope - facing_) * (kMaxTilt / tilt);
    }
    Try(slope);
    if (++num_iterations_ == kMaxNumIterations ||
        step.dot(slope_information_ * step) < kTiltTolerance * kTiltTolerance) {
      stage_ = Stage::kResult;
    }
  }

  void MoveView(size_t view_idx,
                const Eigen::Vector2d& slope,
                const ViewFit& fit,
                const Vector4d& explained) {
    const Eigen::Vector2d translation =
        fit.translation - translation_by_affine_ * (fit.affine - explained);
    const SlopeView& view = problem_.views[view_idx];
    const Eigen::Vector2d xy =
        Position(view_idx) - view.map.Affine(slope) * translation;
    if ((xy - view.xy).norm() <= kMaxMove) Position(view_idx) = xy;
  }

  SlopeProblem& problem_;  // its slope: the best so far
  const Eigen::Vector2d facing_;
  // Of the 4 affine numbers with the translation free, per noise variance.
  Eigen::Matrix4d affine_information_;
  // How the translation follows when the affine numbers are held.
  Eigen::Matrix<double, 2, 4> translation_by_affine_;
  Eigen::Matrix2d slope_information_;  // of a tangent of 1
  // By view. Not a vector of Vector2d, which COLMAP specializes: code with and
  // without its headers would disagree on what that is.
  Eigen::Matrix2Xd positions_;
  Eigen::Matrix2Xd trials_;  // slopes
  Stage stage_ = Stage::kGrid;
  double best_likeness_ = -1.0;
  size_t next_ring_ = 0;
  int num_iterations_ = 0;
};

}  // namespace

void EstimateSlopes(int num_threads,
                    PatchBackend* backend,
                    std::vector<SlopeProblem>* problems) {
  std::vector<SlopeEstimator> estimators;
  estimators.reserve(problems->size());
  for (SlopeProblem& problem : *problems) estimators.emplace_back(&problem);
  const auto is_done = [](const SlopeEstimator& estimator) {
    return estimator.IsDone();
  };
  std::vector<size_t> begins(estimators.size());
  std::vector<PatchJob> jobs;
  std::vector<PatchFit> fits;
  while (!std::all_of(estimators.begin(), estimators.end(), is_done)) {
    size_t num_jobs = 0;
    for (size_t i = 0; i < estimators.size(); ++i) {
      begins[i] = num_jobs;
      num_jobs += estimators[i].NumJobs();
    }
    jobs.resize(num_jobs);
    ParallelFor(estimators.size(), num_threads, [&](size_t i) {
      if (!estimators[i].IsDone())
        estimators[i].MakeJobs(jobs.data() + begins[i]);
    });
    backend->Fit(jobs, &fits);
    ParallelFor(estimators.size(), num_threads, [&](size_t i) {
      estimators[i].Take(fits.data() + begins[i]);
    });
  }
}

}  // namespace mfir
