#include "src/feature/guided_matching.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "src/feature/descriptor_products.h"

namespace mfir {
namespace {

constexpr double kSquaredDescriptorNorm = 512.0 * 512.0;

// Epipolar planes all contain the baseline. With the baseline as axis, a unit
// ray has the longitude of its epipolar half-plane, and the part of it that is
// perpendicular to the axis, as long as the sine of its angle from the axis.
struct AxisCoordinates {
  double longitude = 0.0;  // in (-pi, pi]
  double x = 0.0;
  double y = 0.0;

  double Sine() const { return std::hypot(x, y); }  // 0: at the epipole
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
    return {std::atan2(y, x), x, y};
  }

 private:
  const Eigen::Vector3d axis_;
  const Eigen::Vector3d x_;
  const Eigen::Vector3d y_;
};

// EpipolarError (epipolar_tolerance.h) <= max_error, and the same side of the
// baseline, in coordinates around it. With the vectors p1, p2 perpendicular to
// the axis and v = p1 x p2:
//   v^2 <= max_error^2 ((|p1|^2 - v^2) / f2^2 + (|p2|^2 - v^2) / f1^2),
//   p1 . p2 > 0.
class EpipolarTest {
 public:
  EpipolarTest(double max_error, double focal_length1, double focal_length2)
      : angle1_(max_error / focal_length1),
        angle2_(max_error / focal_length2),
        factor_(1.0 + angle1_ * angle1_ + angle2_ * angle2_) {}

  // Of the longitudes of what may pass with the ray of image 1, for sines of
  // image 2 of at least `min_sine`.
  double HalfWidth(const AxisCoordinates& ray1, double min_sine) const {
    const double max_sine_difference =
        std::hypot(angle1_ / ray1.Sine(), angle2_ / min_sine);
    // The slack is for rounding. Rays of one point are on the same side of the
    // baseline: never more than a quarter turn apart.
    return max_sine_difference < 1.0 ? std::asin(max_sine_difference) + 1e-9
                                     : M_PI_2;
  }

  bool Passes(const AxisCoordinates& ray1, double x2, double y2) const {
    const double product = ray1.x * y2 - ray1.y * x2;
    const double bound =
        angle2_ * angle2_ * (ray1.x * ray1.x + ray1.y * ray1.y) +
        angle1_ * angle1_ * (x2 * x2 + y2 * y2);
    // Without branches: most of the time goes here.
    return (factor_ * product * product <= bound) &
           (ray1.x * x2 + ray1.y * y2 > 0.0);
  }

 private:
  const double angle1_;  // max_error, radians
  const double angle2_;
  const double factor_;
};

// The keypoints of image 2 by longitude, in classes of sines a factor of 2
// wide, since the longitudes within a tolerance depend on them.
class LongitudeIndex {
 public:
  LongitudeIndex(const BaselineFrame& frame, const ImageFeatures& image) {
    std::map<int, std::vector<std::pair<double, uint32_t>>> entries;
    std::vector<AxisCoordinates> coordinates(image.rays->size());
    for (uint32_t i = 0; i < image.rays->size(); ++i) {
      const Eigen::Vector3d& ray = (*image.rays)[i];
      if (!ray.allFinite()) continue;
      coordinates[i] = frame.Coordinates(image.cam_from_world, ray);
      int exponent = 0;
      std::frexp(coordinates[i].Sine(), &exponent);
      // From here to the epipole: one class.
      exponent = std::max(exponent, kMinExponent);
      entries[exponent].emplace_back(coordinates[i].longitude, i);
    }
    for (auto& [exponent, sorted] : entries) {
      std::sort(sorted.begin(), sorted.end());
      Class& c = classes_.emplace_back();
      c.min_sine = exponent == kMinExponent ? 0.0 : std::ldexp(0.5, exponent);
      for (const auto& [longitude, idx] : sorted) {
        c.longitudes.push_back(longitude);
        c.xs.push_back(coordinates[idx].x);
        c.ys.push_back(coordinates[idx].y);
        c.idxs.push_back(idx);
      }
    }
  }

  // Appends the keypoints of image 2 that pass with a ray of image 1.
  void FindCandidates(const EpipolarTest& test,
                      const AxisCoordinates& ray1,
                      std::vector<uint32_t>* candidates) const {
    for (const Class& c : classes_) {
      const double half_width = test.HalfWidth(ray1, c.min_sine);
      for (const double turn : {-2.0 * M_PI, 0.0, 2.0 * M_PI}) {
        const double center = ray1.longitude + turn;
        if (center + half_width < -M_PI || center - half_width > M_PI) continue;
        const auto begin = std::lower_bound(
            c.longitudes.begin(), c.longitudes.end(), center - half_width);
        const auto end =
            std::upper_bound(begin, c.longitudes.end(), center + half_width);
        AppendPassing(test,
                      ray1,
                      c,
                      begin - c.longitudes.begin(),
                      end - c.longitudes.begin(),
                      candidates);
      }
    }
  }

 private:
  static constexpr int kMinExponent = -20;

  struct Class {
    double min_sine = 0.0;
    // By longitude.
    std::vector<double> longitudes;
    std::vector<double> xs;
    std::vector<double> ys;
    std::vector<uint32_t> idxs;  // of keypoints
  };

  static void AppendPassing(const EpipolarTest& test,
                            const AxisCoordinates& ray1,
                            const Class& c,
                            size_t begin,
                            size_t end,
                            std::vector<uint32_t>* candidates) {
    size_t size = candidates->size();
    candidates->resize(size + end - begin);
    for (size_t k = begin; k < end; ++k) {
      (*candidates)[size] = c.idxs[k];
      size += test.Passes(ray1, c.xs[k], c.ys[k]);
    }
    candidates->resize(size);
  }

  std::vector<Class> classes_;
};

// Products of the two most similar descriptors; 0: none.
struct BestTwo {
  int best = 0;
  int second = 0;
  uint32_t best_idx = 0;

  // Of equal ones neither is a match, whatever the order.
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

}  // namespace

std::vector<std::pair<uint32_t, uint32_t>> MatchGuided(
    const GuidedMatchingOptions& options,
    const ImageFeatures& image1,
    const ImageFeatures& image2) {
  const BaselineFrame frame(image1.cam_from_world, image2.cam_from_world);
  const EpipolarTest test(
      options.max_error, image1.focal_length, image2.focal_length);
  const LongitudeIndex index(frame, image2);
  const DescriptorProductsFunction compute_products = BestDescriptorProducts();
  std::vector<BestTwo> best1(image1.rays->size());
  std::vector<BestTwo> best2(image2.rays->size());
  std::vector<uint32_t> candidates;
  std::vector<int32_t> products;
  for (size_t i = 0; i < image1.rays->size(); i += options.query_stride) {
    const Eigen::Vector3d& ray1 = (*image1.rays)[i];
    if (!ray1.allFinite()) continue;
    candidates.clear();
    index.FindCandidates(
        test, frame.Coordinates(image1.cam_from_world, ray1), &candidates);
    products.resize(candidates.size());
    compute_products(image1.descriptors + i * kSiftDescriptorSize,
                     image2.descriptors,
                     candidates.data(),
                     candidates.size(),
                     products.data());
    for (size_t k = 0; k < candidates.size(); ++k) {
      best1[i].Add(products[k], candidates[k]);
      best2[candidates[k]].Add(products[k], static_cast<uint32_t>(i));
    }
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
