#include "src/feature/guided_matching.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "src/geometry/epipolar_tolerance.h"

namespace mfir {
namespace {

constexpr int kDescriptorSize = 128;
constexpr double kSquaredDescriptorNorm = 512.0 * 512.0;

// Epipolar planes all contain the baseline. With the baseline as axis, a ray
// has the longitude of its epipolar half-plane and its angle from the axis.
struct AxisCoordinates {
  double longitude = 0.0;       // in (-pi, pi]
  double sine_from_axis = 0.0;  // 0: at the epipole
};

class BaselineFrame {
 public:
  BaselineFrame(const Rigid3& cam1_from_world, const Rigid3& cam2_from_world)
      : axis_(
            (cam2_from_world.Center() - cam1_from_world.Center()).normalized()),
        x_(axis_.unitOrthogonal()),
        y_(axis_.cross(x_)) {}

  AxisCoordinates Coordinates(const Rigid3& cam_from_world,
                              const Eigen::Vector3d& ray) const {
    const Eigen::Vector3d d = cam_from_world.rotation.conjugate() * ray;
    const double x = d.dot(x_);
    const double y = d.dot(y_);
    return {std::atan2(y, x), std::hypot(x, y)};
  }

 private:
  const Eigen::Vector3d axis_;
  const Eigen::Vector3d x_;
  const Eigen::Vector3d y_;
};

// The keypoints of image 2 by longitude, in classes of sine_from_axis a factor
// of 2 wide, since the longitudes within a tolerance depend on it.
class LongitudeIndex {
 public:
  LongitudeIndex(const BaselineFrame& frame, const ImageFeatures& image) {
    for (uint32_t i = 0; i < image.rays->size(); ++i) {
      const Eigen::Vector3d& ray = (*image.rays)[i];
      if (!ray.allFinite()) continue;
      const AxisCoordinates coordinates =
          frame.Coordinates(image.cam_from_world, ray);
      int exponent = 0;
      std::frexp(coordinates.sine_from_axis, &exponent);
      // From here to the epipole: one class.
      exponent = std::max(exponent, kMinExponent);
      classes_[exponent].push_back({coordinates.longitude, i});
    }
    for (auto& exponent_and_entries : classes_) {
      std::sort(exponent_and_entries.second.begin(),
                exponent_and_entries.second.end());
    }
  }

  // Calls function(idx2) for a superset of the keypoints of image 2 within
  // max_error of a ray of image 1. With the angles a1, a2 from the axis and the
  // difference d of the longitudes, EpipolarError <= max_error means
  //   sin(a1) sin(a2) |sin(d)| <= max_error sqrt(sin(a1)^2 / f2^2
  //                                              + sin(a2)^2 / f1^2).
  template <typename Function>
  void ForEachCandidate(const AxisCoordinates& coordinates1,
                        double focal_length1,
                        double focal_length2,
                        double max_error,
                        const Function& function) const {
    for (const auto& [exponent, entries] : classes_) {
      const double min_sine =
          exponent == kMinExponent ? 0.0 : std::ldexp(0.5, exponent);
      const double max_sine_difference =
          max_error *
          std::hypot(1.0 / (focal_length1 * coordinates1.sine_from_axis),
                     1.0 / (focal_length2 * min_sine));
      // The slack is for rounding. Rays of one point are on the same side of
      // the baseline: never more than a quarter turn apart.
      const double half_width = max_sine_difference < 1.0
                                    ? std::asin(max_sine_difference) + 1e-9
                                    : M_PI_2;
      for (const double turn : {-2.0 * M_PI, 0.0, 2.0 * M_PI}) {
        const double center = coordinates1.longitude + turn;
        for (auto it = std::lower_bound(
                 entries.begin(), entries.end(), Entry{center - half_width, 0});
             it != entries.end() && it->first < center + half_width;
             ++it) {
          function(it->second);
        }
      }
    }
  }

 private:
  static constexpr int kMinExponent = -20;
  using Entry = std::pair<double, uint32_t>;  // longitude, keypoint

  std::map<int, std::vector<Entry>> classes_;
};

// Products of the two most similar descriptors; 0: none.
struct BestTwo {
  int best = 0;
  int second = 0;
  uint32_t best_idx = 0;

  void Add(int product, uint32_t idx) {
    if (product > best) {
      second = best;
      best = product;
      best_idx = idx;
    } else if (product > second) {
      second = product;
    }
  }

  bool IsMatch(const GuidedMatchingOptions& options) const {
    const auto angle = [](int product) {
      return std::acos(std::min(product / kSquaredDescriptorNorm, 1.0));
    };
    return best > 0 && angle(best) <= options.max_distance &&
           angle(best) < options.max_ratio * angle(second);
  }
};

int DescriptorProduct(const uint8_t* a, const uint8_t* b) {
  int sum = 0;
  for (int k = 0; k < kDescriptorSize; ++k) sum += a[k] * b[k];
  return sum;
}

}  // namespace

std::vector<std::pair<uint32_t, uint32_t>> MatchGuided(
    const GuidedMatchingOptions& options,
    const ImageFeatures& image1,
    const ImageFeatures& image2) {
  const BaselineFrame frame(image1.cam_from_world, image2.cam_from_world);
  const Eigen::Matrix3d essential_matrix =
      EssentialMatrix(image1.cam_from_world, image2.cam_from_world);
  const LongitudeIndex index(frame, image2);
  std::vector<BestTwo> best1(image1.rays->size());
  std::vector<BestTwo> best2(image2.rays->size());
  for (uint32_t i = 0; i < image1.rays->size(); ++i) {
    const Eigen::Vector3d& ray1 = (*image1.rays)[i];
    if (!ray1.allFinite()) continue;
    index.ForEachCandidate(
        frame.Coordinates(image1.cam_from_world, ray1),
        image1.focal_length,
        image2.focal_length,
        options.max_error,
        [&](uint32_t j) {
          if (EpipolarError(essential_matrix,
                            ray1,
                            (*image2.rays)[j],
                            image1.focal_length,
                            image2.focal_length) > options.max_error) {
            return;
          }
          const int product =
              DescriptorProduct(image1.descriptors + i * kDescriptorSize,
                                image2.descriptors + j * kDescriptorSize);
          best1[i].Add(product, j);
          best2[j].Add(product, i);
        });
  }
  std::vector<std::pair<uint32_t, uint32_t>> matches;
  for (uint32_t i = 0; i < best1.size(); ++i) {
    if (!best1[i].IsMatch(options)) continue;
    const uint32_t j = best1[i].best_idx;
    if (!options.cross_check ||
        (best2[j].best_idx == i && best2[j].IsMatch(options))) {
      matches.emplace_back(i, j);
    }
  }
  return matches;
}

}  // namespace mfir
