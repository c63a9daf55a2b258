#include "src/selection/overlapping_tracks.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

#include "src/parallel/parallel_for.h"
#include "src/scene/keypoint_grid.h"

namespace mfir {
namespace {

constexpr double kMaxOverlapDistance = 10.0;  // px
constexpr size_t kMinNumOverlapping = 2;

// Tracks of one frame that others can join.
class Leaders {
 public:
  explicit Leaders(const Frame& frame)
      : frame_(frame),
        grids_(frame.images.size(),
               KeypointGrid(kMaxOverlapDistance, kMaxOverlapDistance)) {}

  void Add(size_t point_idx) {
    for (size_t k = frame_.track_begins[point_idx];
         k < frame_.track_begins[point_idx + 1];
         ++k) {
      const Observation& observation = frame_.observations[k];
      grids_[observation.image_idx].Add(observation.xy, point_idx);
    }
  }

  // The one with the most keypoints near those of the track, the first of
  // several; the track itself if there is none.
  size_t Find(size_t point_idx) const {
    std::map<size_t, size_t> counts;
    for (size_t k = frame_.track_begins[point_idx];
         k < frame_.track_begins[point_idx + 1];
         ++k) {
      const Observation& observation = frame_.observations[k];
      grids_[observation.image_idx].ForEachNear(
          observation.xy, [&counts](size_t idx) { ++counts[idx]; });
    }
    size_t leader = point_idx;
    size_t most = kMinNumOverlapping - 1;
    for (const auto& [idx, count] : counts) {
      if (count > most && 2 * count > NumShared(idx, point_idx)) {
        leader = idx;
        most = count;
      }
    }
    return leader;
  }

 private:
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
  std::vector<KeypointGrid> grids_;  // by image
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
