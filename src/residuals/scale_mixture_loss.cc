#include "src/residuals/scale_mixture_loss.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

constexpr int kBinsPerOctave = 8;   // histogram of log2(s)
constexpr int kMinLog2Ratio = -20;  // bins relative to the median of s
constexpr int kMaxLog2Ratio = 80;
constexpr int kNumBins = (kMaxLog2Ratio - kMinLog2Ratio) * kBinsPerOctave;
constexpr size_t kSamplesPerChunk = 65536;
constexpr int kNumIterations = 500;
constexpr double kTolerance = 1e-7;   // change of a mixture weight
constexpr double kMaxSquared = 1e12;  // px^2
constexpr double kMinShare = 1e-6;
constexpr double kStepInSigma = 1.4142135623730951;
// Relative to the sigma that the median suggests. Narrower components would
// only describe points that happen to fit their observations.
constexpr double kMinSigmaRatio = 0.5;
// Components of which exp() is the square of the next wider one's, in a row:
// each squaring doubles the relative error.
constexpr int kMaxNumSquares = 7;
// Narrower components weigh nothing where 1/2 s / sigma^2 is above this.
constexpr double kMaxExponent = 80.0;
// Up to this of the widest component, no weight of it underflows.
constexpr double kMaxWidestExponent = 30.0;

// rho, with its derivatives, of the density sum_k w_k, w_k proportional to
// exp(-1/2 s information_k): rho = -2 log(sum / density_at_zero).
class DensitySum {
 public:
  void Add(double weight, double information) {
    sum_ += weight;
    mean_ += weight * information;
    square_ += weight * information * information;
  }

  // The weights are those of the density / exp(log_scale).
  void Rho(double log_density_at_zero, double log_scale, double rho[3]) const {
    const double mean = mean_ / sum_;
    const double square = square_ / sum_;
    rho[0] = 2.0 * (log_density_at_zero - log_scale - std::log(sum_));
    rho[1] = mean;
    rho[2] = -0.5 * std::max(0.0, square - mean * mean);
  }

 private:
  double sum_ = 0.0;
  double mean_ = 0.0;
  double square_ = 0.0;
};

// Sums of the weights by log2(s / scale).
std::vector<double> Histogram(const std::vector<NoiseSample>& samples,
                              double scale,
                              int num_threads) {
  // Sums by chunk, so that they do not depend on the number of threads.
  const size_t num_chunks =
      (samples.size() + kSamplesPerChunk - 1) / kSamplesPerChunk;
  std::vector<std::vector<double>> parts(num_chunks);
  ParallelFor(num_chunks, num_threads, [&](size_t chunk) {
    parts[chunk].assign(kNumBins, 0.0);
    const size_t end = std::min(samples.size(), (chunk + 1) * kSamplesPerChunk);
    for (size_t i = chunk * kSamplesPerChunk; i < end; ++i) {
      const double bin =
          (std::log2(std::max(samples[i].squared, 1e-300) / scale) -
           kMinLog2Ratio) *
          kBinsPerOctave;
      parts[chunk][static_cast<size_t>(std::clamp(bin, 0.0, kNumBins - 1.0))] +=
          samples[i].weight;
    }
  });
  std::vector<double> sums(kNumBins, 0.0);
  for (const std::vector<double>& part : parts) {
    for (size_t i = 0; i < sums.size(); ++i) sums[i] += part[i];
  }
  return sums;
}

}  // namespace

ScaleMixtureLoss::ScaleMixtureLoss(const std::vector<NoiseSample>& samples,
                                   const Communicator& ranks,
                                   int num_threads) {
  // The likelihood needs s only through a fine histogram of its logarithm.
  const double sigma_of_median =
      std::max(RobustStd(samples, ranks, num_threads), 1e-6);
  const double scale = std::pow(sigma_of_median, 2);
  std::vector<double> counts = Histogram(samples, scale, num_threads);
  ranks.Sum(counts.data(), counts.size());
  const double total_weight =
      std::accumulate(counts.begin(), counts.end(), 0.0);
  for (double& count : counts) count /= total_weight;

  // Up to the largest sample: beyond all components the loss would be
  // quadratic.
  double max_squared = scale;
  for (const NoiseSample& sample : samples) {
    max_squared = std::max(max_squared, std::min(sample.squared, kMaxSquared));
  }
  for (const double max_of_rank :
       Concatenate(ranks, std::vector<double>{max_squared})) {
    max_squared = std::max(max_squared, max_of_rank);
  }
  std::vector<double> variances = {std::pow(kMinSigmaRatio, 2) * scale};
  while (variances.back() < max_squared) {
    variances.push_back(kStepInSigma * kStepInSigma * variances.back());
  }
  std::vector<double> shares(variances.size(), 1.0 / variances.size());

  // exp(-s / (2 sigma^2)) of each bin that has samples, for all components.
  std::vector<double> gaussians;
  for (int bin = 0; bin < kNumBins; ++bin) {
    if (counts[bin] == 0.0) continue;
    const double s =
        scale * std::exp2((bin + 0.5) / kBinsPerOctave + kMinLog2Ratio);
    for (const double variance : variances) {
      gaussians.push_back(std::exp(-0.5 * s / variance));
    }
  }

  std::vector<double> posterior(variances.size());
  for (int iteration = 0; iteration < kNumIterations; ++iteration) {
    std::vector<double> new_shares(variances.size(), 0.0);
    const double* gaussian = gaussians.data();
    for (int bin = 0; bin < kNumBins; ++bin) {
      if (counts[bin] == 0.0) continue;
      double sum = 0.0;
      for (size_t k = 0; k < variances.size(); ++k) {
        posterior[k] = shares[k] / std::sqrt(variances[k]) * *gaussian++;
        sum += posterior[k];
      }
      // Beyond all components: the widest one takes it.
      if (sum < 1e-300) {
        new_shares.back() += counts[bin];
        continue;
      }
      for (size_t k = 0; k < variances.size(); ++k) {
        new_shares[k] += counts[bin] * posterior[k] / sum;
      }
    }
    double change = 0.0;
    for (size_t k = 0; k < shares.size(); ++k) {
      change = std::max(change, std::abs(new_shares[k] - shares[k]));
    }
    shares = new_shares;
    if (change < kTolerance) break;
  }

  for (size_t k = 0; k < variances.size(); ++k) {
    if (shares[k] > kMinShare) {
      const double density = shares[k] / variances[k];
      const bool next_is_double =
          k + 1 < variances.size() && shares[k + 1] > kMinShare;
      components_.push_back({1.0 / variances[k],
                             density,
                             std::log(density),
                             shares[k],
                             next_is_double});
    }
  }
  double rho[3];
  Evaluate(0.0, rho);
  log_density_at_zero_ = -0.5 * rho[0];
}

void ScaleMixtureLoss::Evaluate(double s, double rho[3]) const {
  if (!(0.5 * s * components_.back().information < kMaxWidestExponent)) {
    EvaluateFarOut(s, rho);
    return;
  }
  // From wide to narrow. Most of the time would go into exp().
  DensitySum sum;
  double gaussian = 0.0;
  int num_squares = kMaxNumSquares;
  for (auto component = components_.rbegin(); component != components_.rend();
       ++component) {
    const double exponent = 0.5 * s * component->information;
    if (exponent > kMaxExponent) break;
    if (component->next_is_double && num_squares < kMaxNumSquares) {
      gaussian *= gaussian;
      ++num_squares;
    } else {
      gaussian = std::exp(-exponent);
      num_squares = 0;
    }
    sum.Add(component->density * gaussian, component->information);
  }
  sum.Rho(log_density_at_zero_, /*log_scale=*/0.0, rho);
}

void ScaleMixtureLoss::EvaluateFarOut(double s, double rho[3]) const {
  double max_exponent = -std::numeric_limits<double>::max();
  for (const Component& component : components_) {
    max_exponent = std::max(
        max_exponent, component.log_density - 0.5 * s * component.information);
  }
  DensitySum sum;
  for (const Component& component : components_) {
    sum.Add(std::exp(component.log_density - 0.5 * s * component.information -
                     max_exponent),
            component.information);
  }
  sum.Rho(log_density_at_zero_, max_exponent, rho);
}

double ScaleMixtureLoss::CoreStd() const {
  double rho[3];
  Evaluate(0.0, rho);
  return 1.0 / std::sqrt(rho[1]);
}

double ScaleMixtureLoss::InlierStd() const {
  const double min_information = MinInlierInformation();
  double variance = 0.0;
  double share = 0.0;
  for (const Component& component : components_) {
    if (component.information < min_information) continue;
    variance += component.share / component.information;
    share += component.share;
  }
  return std::sqrt(variance / share);
}

std::vector<NoiseComponent> ScaleMixtureLoss::Components() const {
  constexpr double kMinShare = 1e-6;
  std::vector<NoiseComponent> components;
  for (const Component& component : components_) {
    if (component.share < kMinShare) continue;
    components.push_back(
        {1.0 / std::sqrt(component.information), component.share});
  }
  std::sort(components.begin(),
            components.end(),
            [](const NoiseComponent& a, const NoiseComponent& b) {
              return a.std_px < b.std_px;
            });
  return components;
}

double ScaleMixtureLoss::OutlierShare() const {
  const double min_information = MinInlierInformation();
  double share = 0.0;
  for (const Component& component : components_) {
    if (component.information < min_information) share += component.share;
  }
  return share;
}

double ScaleMixtureLoss::MinInlierInformation() const {
  const double max_std = 4.0 * CoreStd();
  return 1.0 / (max_std * max_std);
}

}  // namespace mfir
