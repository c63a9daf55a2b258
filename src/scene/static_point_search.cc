#include "src/scene/static_point_search.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <unordered_map>
#include <utility>

namespace mfir {
namespace {

constexpr double kMaxDistance = 1.0;  // px
// Of the grid. Larger cells: fewer to look into, but more keypoints in each.
constexpr double kCellSize = 4.0;  // px
constexpr size_t kMinNumCameras = 2;

// Where the tracks of the frames so far have been, each place with the first
// keypoint in every camera.
class Places {
 public:
  // Those that the track of a later frame shows, ascending.
  std::vector<size_t> Find(const Frame& frame, size_t point_idx) {
    std::vector<size_t> agreeing;
    for (const auto& [camera_idx, xy] : Keypoints(frame, point_idx)) {
      const std::vector<size_t> near = FindNear(camera_idx, xy);
      agreeing.insert(agreeing.end(), near.begin(), near.end());
    }
    std::sort(agreeing.begin(), agreeing.end());
    std::vector<size_t> places;
    for (auto begin = agreeing.begin(); begin != agreeing.end();) {
      const auto end = std::upper_bound(begin, agreeing.end(), *begin);
      const size_t num_agreeing = static_cast<size_t>(end - begin);
      if (num_agreeing >= kMinNumCameras &&
          2 * num_agreeing > NumShared(*begin, frame, point_idx)) {
        places.push_back(*begin);
      }
      begin = end;
    }
    return places;
  }

  // Adds a track to the places it shows, which become one; none: a new one.
  void Add(const std::vector<size_t>& place_idxs,
           const TrackIndex& track,
           const Frame& frame) {
    if (place_idxs.empty()) {
      parents_.push_back(parents_.size());
      places_.emplace_back();
    }
    const size_t root =
        place_idxs.empty() ? places_.size() - 1 : Root(place_idxs.front());
    for (const size_t idx : place_idxs) Unite(root, Root(idx));
    Place& place = places_[root];
    place.tracks.push_back(track);
    for (const auto& [camera_idx, xy] : Keypoints(frame, track.point_idx)) {
      if (Has(place, camera_idx)) continue;
      place.camera_idxs.push_back(camera_idx);
      grid_[Cell(camera_idx, CellOf(xy.x()), CellOf(xy.y()))].push_back(
          {xy, root});
    }
  }

  // By place; empty where it has become part of another.
  std::vector<std::vector<TrackIndex>> TakeTracks() {
    std::vector<std::vector<TrackIndex>> tracks;
    for (Place& place : places_) tracks.push_back(std::move(place.tracks));
    return tracks;
  }

 private:
  struct Place {
    std::vector<size_t> camera_idxs;
    std::vector<TrackIndex> tracks;
  };
  struct Keypoint {
    Eigen::Vector2d xy;
    size_t place_idx;
  };

  // One per camera.
  static std::map<size_t, Eigen::Vector2d> Keypoints(const Frame& frame,
                                                     size_t point_idx) {
    std::map<size_t, Eigen::Vector2d> keypoints;
    for (size_t k = frame.track_begins[point_idx];
         k < frame.track_begins[point_idx + 1];
         ++k) {
      const Observation& observation = frame.observations[k];
      keypoints.emplace(frame.images[observation.image_idx].camera_idx,
                        observation.xy);
    }
    return keypoints;
  }

  static int64_t CellOf(double coordinate) {
    return static_cast<int64_t>(
        std::floor(std::clamp(coordinate, -1e9, 1e9) / kCellSize));
  }

  // Cells far apart may share a key: distances are checked anyway.
  static uint64_t Cell(size_t camera_idx, int64_t x, int64_t y) {
    constexpr uint64_t kMask = (1u << 20) - 1;
    return (static_cast<uint64_t>(camera_idx) << 40) |
           ((static_cast<uint64_t>(x) & kMask) << 20) |
           (static_cast<uint64_t>(y) & kMask);
  }

  static bool Has(const Place& place, size_t camera_idx) {
    return std::find(place.camera_idxs.begin(),
                     place.camera_idxs.end(),
                     camera_idx) != place.camera_idxs.end();
  }

  size_t Root(size_t place_idx) {
    while (parents_[place_idx] != place_idx) {
      parents_[place_idx] = parents_[parents_[place_idx]];
      place_idx = parents_[place_idx];
    }
    return place_idx;
  }

  void Unite(size_t root, size_t other) {
    if (other == root) return;
    parents_[other] = root;
    Place& target = places_[root];
    const Place source = std::exchange(places_[other], {});
    target.tracks.insert(
        target.tracks.end(), source.tracks.begin(), source.tracks.end());
    for (const size_t camera_idx : source.camera_idxs) {
      if (!Has(target, camera_idx)) target.camera_idxs.push_back(camera_idx);
    }
  }

  // Each once.
  std::vector<size_t> FindNear(size_t camera_idx, const Eigen::Vector2d& xy) {
    std::vector<size_t> near;
    for (int64_t x = CellOf(xy.x() - kMaxDistance);
         x <= CellOf(xy.x() + kMaxDistance);
         ++x) {
      for (int64_t y = CellOf(xy.y() - kMaxDistance);
           y <= CellOf(xy.y() + kMaxDistance);
           ++y) {
        const auto cell = grid_.find(Cell(camera_idx, x, y));
        if (cell == grid_.end()) continue;
        for (const Keypoint& keypoint : cell->second) {
          if ((keypoint.xy - xy).norm() > kMaxDistance) continue;
          near.push_back(Root(keypoint.place_idx));
        }
      }
    }
    std::sort(near.begin(), near.end());
    near.erase(std::unique(near.begin(), near.end()), near.end());
    return near;
  }

  size_t NumShared(size_t place_idx,
                   const Frame& frame,
                   size_t point_idx) const {
    size_t count = 0;
    for (const auto& camera_and_xy : Keypoints(frame, point_idx)) {
      count += Has(places_[place_idx], camera_and_xy.first);
    }
    return count;
  }

  std::vector<Place> places_;
  std::vector<size_t> parents_;  // of a root: itself
  std::unordered_map<uint64_t, std::vector<Keypoint>> grid_;
};

}  // namespace

std::vector<std::vector<TrackIndex>> FindStaticPoints(const Scene& scene) {
  if (scene.frames.size() < 2) return {};
  Places places;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    // Tracks of one frame are different points.
    std::vector<std::vector<size_t>> found;
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      found.push_back(places.Find(frame, i));
    }
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      places.Add(found[i], {f, i}, frame);
    }
  }
  std::vector<std::vector<TrackIndex>> points;
  for (std::vector<TrackIndex>& tracks : places.TakeTracks()) {
    if (tracks.empty()) continue;
    std::sort(tracks.begin(), tracks.end());
    if (tracks.front().frame_idx == tracks.back().frame_idx) continue;
    points.push_back(std::move(tracks));
  }
  return points;
}

}  // namespace mfir
