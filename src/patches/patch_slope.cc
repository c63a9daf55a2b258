#include "src/patches/patch_slope.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

namespace mfir {
namespace {

// Tilts of the grid: tangents of the angle, and how many directions of each.
struct TiltRing {
  double tangent;
  int num_directions;
};
constexpr TiltRing kTiltRings[] = {{0.45, 8}, {0.9, 12}, {1.6, 12}};
// Mean likeness with the facing slope from which no grid is needed.
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

class SlopeEstimator {
 public:
  SlopeEstimator(const ReferencePatch& reference,
                 const PatchTemplate& patch,
                 const std::vector<SlopeView>& views)
      : reference_(reference),
        patch_(patch),
        views_(views),
        facing_(reference.FacingSlope()) {
    const Eigen::Map<
        const Eigen::
            Matrix<float, kNumPatchBasis, kNumPatchBasis, Eigen::RowMajor>>
        inverse(patch.inverse);
    affine_information_ = inverse.block<4, 4>(2, 2).cast<double>().inverse();
    translation_by_affine_ =
        inverse.block<2, 4>(0, 2).cast<double>() * affine_information_;
    // Slopes are about tangents times the size of a pixel on the ray.
    const Eigen::Matrix2d tangent_from_slope =
        reference.ray_jacobian.transpose().inverse() *
        reference.Ray().squaredNorm();
    slope_information_ = tangent_from_slope.transpose() * tangent_from_slope;
  }

  Eigen::Vector2d Run() {
    ResetPositions();
    Eigen::Vector2d best = facing_;
    double best_likeness = MeanLikeness(best);
    if (best_likeness < kGoodLikeness) SearchGrid(&best, &best_likeness);
    const Eigen::Vector2d refined = Iterate(best);
    return MeanLikeness(refined) >= best_likeness ? refined : best;
  }

 private:
  void ResetPositions() {
    positions_.resize(2, static_cast<Eigen::Index>(views_.size()));
    for (size_t i = 0; i < views_.size(); ++i) Position(i) = views_[i].xy;
  }

  Eigen::Matrix2Xd::ColXpr Position(size_t view_idx) {
    return positions_.col(static_cast<Eigen::Index>(view_idx));
  }
  Eigen::Vector2d Position(size_t view_idx) const {
    return positions_.col(static_cast<Eigen::Index>(view_idx));
  }

  PatchWarp Warp(size_t view_idx, const Eigen::Vector2d& slope) const {
    const Eigen::Matrix2d affine = views_[view_idx].map.Affine(slope);
    const Eigen::Vector2d xy = Position(view_idx);
    return {{xy.x(), xy.y()},
            {static_cast<float>(affine(0, 0)),
             static_cast<float>(affine(0, 1)),
             static_cast<float>(affine(1, 0)),
             static_cast<float>(affine(1, 1))},
            {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}};
  }

  ViewFit Fit(size_t view_idx, const Eigen::Vector2d& slope) const {
    ViewFit result;
    PatchFit fit;
    const PatchWarp warp = Warp(view_idx, slope);
    if (warp.affine[0] * warp.affine[3] - warp.affine[1] * warp.affine[2] <=
            0.0f ||
        !FitPatch(patch_, *views_[view_idx].image, warp, &fit)) {
      return result;
    }
    const Eigen::Map<const Eigen::Matrix<float, kNumPatchBasis, 1>> c(
        fit.coefficients);
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

  double MeanLikeness(const Eigen::Vector2d& slope) const {
    double sum = 0.0;
    for (size_t i = 0; i < views_.size(); ++i) {
      const ViewFit fit = Fit(i, slope);
      sum += fit.valid ? fit.likeness : 0.0;
    }
    return sum / std::max<double>(static_cast<double>(views_.size()), 1.0);
  }

  void SearchGrid(Eigen::Vector2d* best, double* best_likeness) const {
    for (const TiltRing& ring : kTiltRings) {
      for (int i = 0; i < ring.num_directions; ++i) {
        const double angle = 2.0 * M_PI * i / ring.num_directions;
        const Eigen::Vector2d slope = SlopeOfTilt(
            reference_,
            ring.tangent * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
        const double likeness = MeanLikeness(slope);
        if (likeness > *best_likeness) {
          *best = slope;
          *best_likeness = likeness;
        }
      }
    }
  }

  // The 4 affine numbers by the slope: a change of inverse depth moves the
  // patch along the epipolar line, here in pixels of the reference image.
  Eigen::Matrix<double, 4, 2> AffineBySlope(
      size_t view_idx, const Eigen::Vector2d& slope) const {
    const PatchMap& map = views_[view_idx].map;
    const Eigen::Vector2d e =
        kPatchRadius * (map.Affine(slope).inverse() * map.epipole);
    Eigen::Matrix<double, 4, 2> result;
    result << e.x(), 0.0, 0.0, e.x(), e.y(), 0.0, 0.0, e.y();
    return result;
  }

  Eigen::Vector2d Iterate(Eigen::Vector2d slope) {
    for (int iteration = 0; iteration < kMaxNumIterations; ++iteration) {
      Eigen::Matrix2d information =
          slope_information_ / (kPriorTilt * kPriorTilt);
      Eigen::Vector2d gradient = information * (slope - facing_);
      std::vector<ViewFit> fits;
      std::vector<Eigen::Matrix<double, 4, 2>> jacobians;
      for (size_t i = 0; i < views_.size(); ++i) {
        fits.push_back(Fit(i, slope));
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
      if (!step.allFinite()) return slope;
      for (size_t i = 0; i < views_.size(); ++i) {
        if (fits[i].valid) MoveView(i, slope, fits[i], jacobians[i] * step);
      }
      slope -= step;
      const double tilt = std::sqrt(
          (slope - facing_).dot(slope_information_ * (slope - facing_)));
      if (tilt > kMaxTilt) {
        slope = facing_ + (slope - facing_) * (kMaxTilt / tilt);
      }
      if (step.dot(slope_information_ * step) <
          kTiltTolerance * kTiltTolerance) {
        break;
      }
    }
    return slope;
  }

  void MoveView(size_t view_idx,
                const Eigen::Vector2d& slope,
                const ViewFit& fit,
                const Vector4d& explained) {
    const Eigen::Vector2d translation =
        fit.translation - translation_by_affine_ * (fit.affine - explained);
    const SlopeView& view = views_[view_idx];
    const Eigen::Vector2d xy =
        Position(view_idx) - view.map.Affine(slope) * translation;
    if ((xy - view.xy).norm() <= kMaxMove) Position(view_idx) = xy;
  }

  const ReferencePatch& reference_;
  const PatchTemplate& patch_;
  const std::vector<SlopeView>& views_;
  const Eigen::Vector2d facing_;
  // Of the 4 affine numbers with the translation free, per noise variance.
  Eigen::Matrix4d affine_information_;
  // How the translation follows when the affine numbers are held.
  Eigen::Matrix<double, 2, 4> translation_by_affine_;
  Eigen::Matrix2d slope_information_;  // of a tangent of 1
  // By view. Not a vector of Vector2d, which COLMAP specializes: code with and
  // without its headers would disagree on what that is.
  Eigen::Matrix2Xd positions_;
};

}  // namespace

Eigen::Vector2d EstimateSlope(const ReferencePatch& reference,
                              const PatchTemplate& patch,
                              const std::vector<SlopeView>& views) {
  return SlopeEstimator(reference, patch, views).Run();
}

}  // namespace mfir
