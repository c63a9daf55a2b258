#include "src/feature/sift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>
#include <utility>

#include <Eigen/Core>
#include <Eigen/LU>

#include "src/feature/sift_descriptor.h"

namespace mfir {
namespace {

constexpr int kMaxNumMoves = 5;
// Offsets (grid steps) beyond which a keypoint moves on, and beyond which the
// parabola through its neighbours says nothing.
constexpr double kMoveOffset = 0.6;
constexpr double kMaxOffset = 1.5;
// Extrema below this share of the peak threshold are not refined.
constexpr double kCandidateShare = 0.8;

// Of one level of an octave, and what descriptors need of it.
struct LevelKeypoints {
  int octave = 0;
  std::vector<SiftFrame> frames;  // pixels of the octave
  FloatImage image;
};

// Rows of the differences of Gaussians around one row: of each level three,
// which are reused.
class DifferenceRows {
 public:
  explicit DifferenceRows(const Octave& octave)
      : octave_(octave), width_(octave.levels[0].width) {
    rows_.resize(3 * (octave.levels.size() - 1),
                 std::vector<float>(static_cast<size_t>(width_)));
  }

  void Compute(int y) {
    for (size_t level = 0; level + 1 < octave_.levels.size(); ++level) {
      const float* lower = octave_.levels[level].Row(y);
      const float* upper = octave_.levels[level + 1].Row(y);
      float* row = rows_[3 * level + y % 3].data();
      for (int x = 0; x < width_; ++x) row[x] = upper[x] - lower[x];
    }
  }

  const float* Row(int level, int y) const {
    return rows_[3 * level + y % 3].data();
  }

 private:
  const Octave& octave_;
  const int width_;
  std::vector<std::vector<float>> rows_;
};

// Whether the value exceeds (sign 1) or is below (-1) its 26 neighbours.
bool IsExtremum(
    const DifferenceRows& rows, int level, int x, int y, float sign) {
  const float value = sign * rows.Row(level, y)[x];
  // Neighbours along the row first: they rule out most.
  for (const int l : {level, level - 1, level + 1}) {
    for (const int row : {y, y - 1, y + 1}) {
      const float* values = rows.Row(l, row) + x;
      if (sign * values[-1] >= value || sign * values[1] >= value) return false;
      if ((l != level || row != y) && sign * values[0] >= value) return false;
    }
  }
  return true;
}

struct GridPosition {
  int level;
  int y;
  int x;

  bool operator<(const GridPosition& other) const {
    return std::tie(level, y, x) < std::tie(other.level, other.y, other.x);
  }
};

std::vector<GridPosition> FindExtrema(const Octave& octave, float threshold) {
  const int width = octave.levels[0].width;
  const int height = octave.levels[0].height;
  const int num_differences = static_cast<int>(octave.levels.size()) - 1;
  DifferenceRows rows(octave);
  rows.Compute(0);
  rows.Compute(1);
  std::vector<GridPosition> extrema;
  for (int y = 1; y < height - 1; ++y) {
    rows.Compute(y + 1);
    for (int level = 1; level < num_differences - 1; ++level) {
      const float* row = rows.Row(level, y);
      for (int x = 1; x < width - 1; ++x) {
        if (std::abs(row[x]) < threshold) continue;
        if (IsExtremum(rows, level, x, y, row[x] > 0.0f ? 1.0f : -1.0f)) {
          extrema.push_back({level, y, x});
        }
      }
    }
  }
  std::sort(extrema.begin(), extrema.end());
  return extrema;
}

// The parabola through the differences of Gaussians around a grid position;
// coordinates are x, y and level.
struct Parabola {
  double value;
  Eigen::Vector3d gradient;
  Eigen::Matrix3d hessian;
  Eigen::Vector3d offset;  // of its extremum; 0 where there is none

  Parabola(const Octave& octave, const GridPosition& at) {
    const auto d = [&](int dx, int dy, int dl) {
      return static_cast<double>(
                 octave.levels[at.level + dl + 1].At(at.x + dx, at.y + dy)) -
             octave.levels[at.level + dl].At(at.x + dx, at.y + dy);
    };
    value = d(0, 0, 0);
    gradient << 0.5 * (d(1, 0, 0) - d(-1, 0, 0)),
        0.5 * (d(0, 1, 0) - d(0, -1, 0)), 0.5 * (d(0, 0, 1) - d(0, 0, -1));
    hessian(0, 0) = d(1, 0, 0) + d(-1, 0, 0) - 2.0 * value;
    hessian(1, 1) = d(0, 1, 0) + d(0, -1, 0) - 2.0 * value;
    hessian(2, 2) = d(0, 0, 1) + d(0, 0, -1) - 2.0 * value;
    hessian(0, 1) = hessian(1, 0) =
        0.25 * (d(1, 1, 0) + d(-1, -1, 0) - d(-1, 1, 0) - d(1, -1, 0));
    hessian(0, 2) = hessian(2, 0) =
        0.25 * (d(1, 0, 1) + d(-1, 0, -1) - d(-1, 0, 1) - d(1, 0, -1));
    hessian(1, 2) = hessian(2, 1) =
        0.25 * (d(0, 1, 1) + d(0, -1, -1) - d(0, -1, 1) - d(0, 1, -1));
    const Eigen::FullPivLU<Eigen::Matrix3d> lu(hessian);
    offset = lu.isInvertible() ? lu.solve(-gradient).eval()
                               : Eigen::Vector3d::Zero();
  }

  double Peak() const { return value + 0.5 * gradient.dot(offset); }

  // Ratio of the principal curvatures in the image is below `threshold`.
  bool IsNoEdge(double threshold) const {
    const double trace = hessian(0, 0) + hessian(1, 1);
    const double determinant =
        hessian(0, 0) * hessian(1, 1) - hessian(0, 1) * hessian(0, 1);
    return determinant > 0.0 &&
           trace * trace / determinant <
               (threshold + 1.0) * (threshold + 1.0) / threshold;
  }
};

// A step of the grid towards the extremum that stays inside.
int Step(double offset, int position, int size) {
  if (offset > kMoveOffset && position < size - 2) return 1;
  if (offset < -kMoveOffset && position > 1) return -1;
  return 0;
}

// Appends the keypoint of an extremum to its level, if it is a good one.
void Refine(const SiftOptions& options,
            const Octave& octave,
            GridPosition at,
            std::vector<LevelKeypoints>* levels) {
  const int width = octave.levels[0].width;
  const int height = octave.levels[0].height;
  Parabola parabola(octave, at);
  for (int i = 1; i < kMaxNumMoves; ++i) {
    const int dx = Step(parabola.offset.x(), at.x, width);
    const int dy = Step(parabola.offset.y(), at.y, height);
    if (dx == 0 && dy == 0) break;
    at.x += dx;
    at.y += dy;
    parabola = Parabola(octave, at);
  }
  const Eigen::Vector3d position =
      Eigen::Vector3d(at.x, at.y, at.level) + parabola.offset;
  const Eigen::Vector3d last(
      width - 1, height - 1, static_cast<double>(octave.levels.size()) - 1.0);
  if (std::abs(parabola.Peak()) <= options.peak_threshold ||
      !parabola.IsNoEdge(options.edge_threshold) ||
      !(parabola.offset.cwiseAbs().maxCoeff() < kMaxOffset) ||
      (position.array() < 0.0).any() ||
      (position.array() > last.array()).any()) {
    return;
  }
  (*levels)[at.level - 1].frames.push_back(
      {position.x(),
       position.y(),
       kFirstSigma * std::exp2(position.z() / options.octave_resolution)});
}

// The keypoints of all levels, finest first.
std::vector<LevelKeypoints> Detect(const SiftOptions& options,
                                   const FloatImage& image) {
  const auto threshold =
      static_cast<float>(kCandidateShare * options.peak_threshold);
  ScaleSpace space(image, options.first_octave, options.octave_resolution);
  std::vector<LevelKeypoints> all_levels;
  for (int i = 0; i < options.num_octaves; ++i) {
    if (i > 0 && !space.Next()) break;
    Octave& octave = space.Current();
    std::vector<LevelKeypoints> levels(options.octave_resolution);
    for (const GridPosition& at : FindExtrema(octave, threshold)) {
      Refine(options, octave, at, &levels);
    }
    for (int l = 0; l < options.octave_resolution; ++l) {
      levels[l].octave = octave.index;
      FloatImage& level_image = octave.levels[l + 1];
      // The next octave is made from the last.
      if (l + 1 == options.octave_resolution) {
        levels[l].image = level_image;
      } else {
        levels[l].image = std::move(level_image);
      }
      all_levels.push_back(std::move(levels[l]));
    }
  }
  return all_levels;
}

size_t FirstLevelToKeep(const SiftOptions& options,
                        const std::vector<LevelKeypoints>& levels) {
  size_t num_features = 0;
  for (size_t i = levels.size(); i > 0; --i) {
    num_features += levels[i - 1].frames.size();
    if (num_features > static_cast<size_t>(options.max_num_features)) {
      return i - 1;
    }
  }
  return 0;
}

void AppendDescriptor(const std::array<float, kSiftDescriptorSize>& descriptor,
                      bool root,
                      std::vector<uint8_t>* bytes) {
  float sum = 0.0f;
  for (const float value : descriptor) sum += value;
  for (const float value : descriptor) {
    const float element =
        root ? std::sqrt(value / std::max(sum, 1e-12f)) : value;
    bytes->push_back(
        static_cast<uint8_t>(std::min(std::round(512.0f * element), 255.0f)));
  }
}

void Describe(const SiftOptions& options,
              const LevelKeypoints& level,
              SiftFeatures* features) {
  const auto pixel_size = static_cast<float>(std::exp2(level.octave));
  for (const SiftFrame& frame : level.frames) {
    const std::vector<double> orientations =
        options.upright ? std::vector<double>{0.0}
                        : SiftOrientations(level.image, frame);
    for (size_t i = 0; i < std::min<size_t>(orientations.size(),
                                            options.max_num_orientations);
         ++i) {
      features->keypoints.push_back(
          {static_cast<float>(frame.x) * pixel_size + 0.5f,
           static_cast<float>(frame.y) * pixel_size + 0.5f,
           static_cast<float>(frame.sigma) * pixel_size,
           static_cast<float>(orientations[i])});
      AppendDescriptor(SiftDescriptor(level.image, frame, orientations[i]),
                       options.root,
                       &features->descriptors);
    }
  }
}

}  // namespace

SiftFeatures ExtractSift(const SiftOptions& options, const FloatImage& image) {
  SiftFeatures features;
  // Pixels of the first octave.
  const double smaller_side =
      std::ldexp(std::min(image.width, image.height), -options.first_octave);
  if (smaller_side < ScaleSpace::kMinSide) return features;
  std::vector<LevelKeypoints> levels = Detect(options, image);
  for (size_t i = FirstLevelToKeep(options, levels); i < levels.size(); ++i) {
    Describe(options, levels[i], &features);
    levels[i] = {};
  }
  return features;
}

}  // namespace mfir
