#include "colmap_ext/controllers/pair_tolerance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "colmap_ext/controllers/frame_verification.h"

namespace mfir {
namespace {

// Keypoints are no better than this; pixels.
constexpr double kMinTolerance = 1.0;
// Pairs with at least so many right matches tell their own tolerance.
constexpr size_t kMinInliersOfOwnTolerance = 30;
// Of wrong pairs in a frame that pass the test: at most 10^-3 expected.
constexpr double kMaxFalsePairs = 1e-3;
// Random pairs of keypoints per match, to learn how wrong matches look.
constexpr size_t kNumShifts = 20;

// Share of random pairs of the same keypoints with an error below max_error.
double RandomShare(const MatchingPair& pair) {
  const IndexMatches& matches = pair.sample;
  const size_t n = matches.size();
  // Laplace's rule keeps the share above 0.
  size_t num_random = 2;
  size_t num_within = 1;
  for (size_t shift = 1; shift < std::min(n, kNumShifts + 1); ++shift) {
    for (size_t i = 0; i < n; ++i) {
      num_within +=
          MatchError(pair, matches[i].first, matches[(i + shift) % n].second) <=
          pair.max_error;
      ++num_random;
    }
  }
  return static_cast<double>(num_within) / static_cast<double>(num_random);
}

}  // namespace

double MatchError(const MatchingPair& pair, size_t idx1, size_t idx2) {
  const double error = EpipolarError(pair.essential_matrix,
                                     pair.image1->rays[idx1],
                                     pair.image2->rays[idx2],
                                     pair.image1->focal_length,
                                     pair.image2->focal_length);
  // Also false for NaN.
  return std::isfinite(error) ? error : std::numeric_limits<double>::max();
}

void EstimateTolerance(MatchingPair* pair) {
  pair->errors.clear();
  for (const auto& [idx1, idx2] : pair->sample) {
    pair->errors.push_back(MatchError(*pair, idx1, idx2));
  }
  pair->random_share = pair->is_guided ? 1.0 : RandomShare(*pair);
  pair->estimate = EstimateEpipolarTolerance(
      pair->errors, pair->random_share, kMinTolerance, pair->max_error);
}

bool HasOwnTolerance(const MatchingPair& pair) {
  return pair.estimate.num_inliers >= kMinInliersOfOwnTolerance;
}

void SetTolerances(std::vector<MatchingPair>* pairs) {
  std::vector<double> tolerances;
  for (const MatchingPair& pair : *pairs) {
    if (HasOwnTolerance(pair)) tolerances.push_back(pair.estimate.tolerance);
  }
  for (MatchingPair& pair : *pairs) {
    pair.tolerance = tolerances.empty() || HasOwnTolerance(pair)
                         ? pair.estimate.tolerance
                         : std::min(Quantile(tolerances, 0.5), pair.max_error);
  }
}

bool CouldBeChance(const MatchingPair& pair, size_t num_pairs) {
  const size_t num_within =
      std::count_if(pair.errors.begin(), pair.errors.end(), [&](double error) {
        return error <= pair.tolerance;
      });
  return LogNumFalseAlarms(pair.errors.size(),
                           num_within,
                           pair.tolerance,
                           pair.random_share,
                           pair.max_error) >
         std::log(kMaxFalsePairs / static_cast<double>(num_pairs));
}

}  // namespace mfir
