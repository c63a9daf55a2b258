#include "src/scene/overlapping_tracks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <map>
#include <tuple>
#include <utility>

#include "src/util/parallel_for.h"

namespace mfir {
namespace {

constexpr double kMaxDistance = 10.0;  // px
constexpr size_t kMinNumCameras = 2;

// Tracks of one frame that others can join.
class Leaders {
 public:
  explicit Leaders(const Frame& frame) : frame_(frame) {}

  void Add(size_t point_idx) {
    for (size_t k = frame_.track_begins[point_idx];
         k < frame_.track_begins[point_idx + 1];
         ++k) {
      const Observation& observation = frame_.observations[k];
      grid_[CellOf(observation, 0, 0)].push_back({point_idx, observation.xy});
    }
  }

  // The one with the most keypoints near those of the track, the first of
  // several; the track itself if there is none.
  size_t Find(size_t point_idx) const {
    std::map<size_t, size_t> counts;
    for (size_t k = frame_.track_begins[point_idx];
         k < frame_.track_begins[point_idx + 1];
         ++k) {
      CountNear(frame_.observations[k], &counts);
    }
    size_t leader = point_idx;
    size_t most = kMinNumCameras - 1;
    for (const auto& [idx, count] : counts) {
      if (count > most && 2 * count > NumShared(idx, point_idx)) {
        leader = idx;
        most = count;
      }
    }
    return leader;
  }

 private:
  using Cell = std::tuple<size_t, int64_t, int64_t>;  // image, column, row
  struct Keypoint {
    size_t point_idx;
    Eigen::Vector2d xy;
  };

  static Cell CellOf(const Observation& observation, int64_t dx, int64_t dy) {
    const auto idx = [](double coordinate) {
      return static_cast<int64_t>(
          std::floor(std::clamp(coordinate, -1e9, 1e9) / kMaxDistance));
    };
    return {observation.image_idx,
            idx(observation.xy.x()) + dx,
            idx(observation.xy.y()) + dy};
  }

  void CountNear(const Observation& observation,
                 std::map<size_t, size_t>* counts) const {
    for (int64_t dx = -1; dx <= 1; ++dx) {
      for (int64_t dy = -1; dy <= 1; ++dy) {
        const auto cell = grid_.find(CellOf(observation, dx, dy));
        if (cell == grid_.end()) continue;
        for (const Keypoint& keypoint : cell->second) {
          (*counts)[keypoint.point_idx] +=
              (keypoint.xy - observation.xy).norm() <= kMaxDistance;
        }
      }
    }
  }

  size_t NumShared(size_t a, size_t b) const {
    size_t count = 0;
    for (size_t k = frame_.track_begins[a]; k < frame_.track_begins[a + 1];
         ++k) {
      for (size_t l = frame_.track_begins[b]; l < frame_.track_begins[b + 1];
           ++l) {
        count += frame_.observations[k].image_idx ==
                 frame_.observations[l].image_idx;
      }
    }
    return count;
  }

  const Frame& frame_;
  std::map<Cell, std::vector<Keypoint>> grid_;
};

}  // namespace

std::vector<std::vector<TrackIndex>> GroupOverlappingTracks(
    const Scene& scene,
    const std::vector<std::vector<TrackIndex>>& static_points,
    int num_threads) {
  // A static point joins where its first frame shows it; its other tracks
  // follow.
  std::map<TrackIndex, size_t> static_idxs;  // by first track
  std::vector<std::vector<bool>> follows(scene.frames.size());
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    follows[f].resize(scene.frames[f].NumPoints(), false);
  }
  for (size_t i = 0; i < static_points.size(); ++i) {
    static_idxs[static_points[i].front()] = i;
    for (auto it = std::next(static_points[i].begin());
         it != static_points[i].end();
         ++it) {
      follows[it->frame_idx][it->point_idx] = true;
    }
  }
  std::vector<std::map<size_t, std::vector<TrackIndex>>> groups(
      scene.frames.size());  // by frame and leader
  ParallelFor(scene.frames.size(), num_threads, [&](size_t f) {
    Leaders leaders(scene.frames[f]);
    for (size_t i = 0; i < scene.frames[f].NumPoints(); ++i) {
      if (follows[f][i]) continue;
      const size_t leader = leaders.Find(i);
      if (leader == i) leaders.Add(i);
      std::vector<TrackIndex>& group = groups[f][leader];
      const auto point = static_idxs.find({f, i});
      if (point == static_idxs.end()) {
        group.push_back({f, i});
      } else {
        const std::vector<TrackIndex>& tracks = static_points[point->second];
        group.insert(group.end(), tracks.begin(), tracks.end());
      }
    }
  });
  std::vector<std::vector<TrackIndex>> result;
  for (auto& frame_groups : groups) {
    for (auto& leader_and_group : frame_groups) {
      std::vector<TrackIndex>& group = leader_and_group.second;
      if (group.size() < 2) continue;
      std::sort(group.begin(), group.end());
      result.push_back(std::move(group));
    }
  }
  return result;
}

}  // namespace mfir
