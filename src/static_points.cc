#include "static_points.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "errors.h"
#include "median.h"

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

struct MergedTrack {
  size_t frame_idx = 0;
  Eigen::Vector3d xyz;
  std::vector<Observation> observations;
};

// Keypoints of a static point in a camera.
struct CameraKeypoints {
  std::vector<double> x;
  std::vector<double> y;
  // By frame: the first keypoint's index.
  std::map<size_t, uint32_t> keypoint_idxs;
};

std::map<size_t, CameraKeypoints> CollectKeypoints(
    const Scene& scene, const std::vector<TrackIndex>& tracks) {
  std::map<size_t, CameraKeypoints> keypoints;
  for (const TrackIndex& track : tracks) {
    const Frame& frame = scene.frames[track.frame_idx];
    for (size_t k = frame.track_begins[track.point_idx];
         k < frame.track_begins[track.point_idx + 1];
         ++k) {
      const Observation& observation = frame.observations[k];
      CameraKeypoints& camera =
          keypoints[frame.images[observation.image_idx].camera_idx];
      camera.x.push_back(observation.xy.x());
      camera.y.push_back(observation.xy.y());
      camera.keypoint_idxs.emplace(track.frame_idx, observation.keypoint_idx);
    }
  }
  return keypoints;
}

MergedTrack MergeTracks(const Scene& scene,
                        const std::vector<TrackIndex>& tracks) {
  const std::map<size_t, CameraKeypoints> keypoints =
      CollectKeypoints(scene, tracks);
  MergedTrack merged;
  std::pair<size_t, size_t> best = {0, 0};
  for (const TrackIndex& track : tracks) {
    const Frame& frame = scene.frames[track.frame_idx];
    std::vector<Observation> observations;
    size_t num_seen = 0;
    for (size_t i = 0; i < frame.images.size(); ++i) {
      const auto camera = keypoints.find(frame.images[i].camera_idx);
      if (camera == keypoints.end()) continue;
      Observation observation;
      observation.image_idx = i;
      observation.xy = {Median(camera->second.x), Median(camera->second.y)};
      const auto seen = camera->second.keypoint_idxs.find(track.frame_idx);
      const bool is_seen = seen != camera->second.keypoint_idxs.end();
      observation.keypoint_idx = is_seen ? seen->second : kNoKeypoint;
      observations.push_back(observation);
      num_seen += is_seen;
    }
    const std::pair<size_t, size_t> score = {observations.size(), num_seen};
    if (score <= best) continue;
    best = score;
    merged = {track.frame_idx,
              frame.points[track.point_idx],
              std::move(observations)};
  }
  return merged;
}

size_t NumObservations(const Scene& scene) {
  size_t count = 0;
  for (const Frame& frame : scene.frames) count += frame.observations.size();
  return count;
}

}  // namespace

std::vector<std::vector<TrackIndex>> FindStaticPoints(const Scene& scene) {
  Places places;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    // Tracks of one frame are different points.
    std::vector<std::vector<size_t>> found;
    for (size_t i = 0; i < frame.points.size(); ++i) {
      found.push_back(places.Find(frame, i));
    }
    for (size_t i = 0; i < frame.points.size(); ++i) {
      places.Add(found[i], {f, i}, frame);
    }
  }
  std::vector<std::vector<TrackIndex>> points;
  for (std::vector<TrackIndex>& tracks : places.TakeTracks()) {
    if (tracks.empty()) continue;
    std::sort(tracks.begin(),
              tracks.end(),
              [](const TrackIndex& a, const TrackIndex& b) {
                return std::tie(a.frame_idx, a.point_idx) <
                       std::tie(b.frame_idx, b.point_idx);
              });
    if (tracks.front().frame_idx == tracks.back().frame_idx) continue;
    points.push_back(std::move(tracks));
  }
  return points;
}

StaticPoints::StaticPoints(const std::string& treatment, Scene* scene) {
  const std::vector<std::vector<TrackIndex>> points = FindStaticPoints(*scene);
  std::vector<std::vector<bool>> is_static;
  for (const Frame& frame : scene->frames) {
    is_static.emplace_back(frame.points.size(), false);
  }
  size_t num_observations = 0;
  for (const std::vector<TrackIndex>& tracks : points) {
    num_tracks_ += tracks.size();
    for (const auto& [frame_idx, point_idx] : tracks) {
      is_static[frame_idx][point_idx] = true;
      const Frame& frame = scene->frames[frame_idx];
      num_observations +=
          frame.track_begins[point_idx + 1] - frame.track_begins[point_idx];
    }
  }
  num_points_ = points.size();
  const size_t num_all = NumObservations(*scene);
  if (num_all > 0) {
    observation_share_ =
        static_cast<double>(num_observations) / static_cast<double>(num_all);
  }
  if (treatment == "keep" || points.empty()) return;

  num_merged_.assign(scene->frames.size(), 0);
  std::vector<MergedTrack> merged;
  if (treatment == "merge") {
    for (const std::vector<TrackIndex>& tracks : points) {
      merged.push_back(MergeTracks(*scene, tracks));
    }
  } else if (num_observations == num_all) {
    throw InputError(
        "All tracks are in place in several frames, so that "
        "--MultiFrame.static_points drop leaves none. Use merge.");
  }
  tracks_.emplace(std::move(is_static), scene);
  for (const MergedTrack& track : merged) {
    Frame& frame = scene->frames[track.frame_idx];
    frame.points.push_back(track.xyz);
    frame.observations.insert(frame.observations.end(),
                              track.observations.begin(),
                              track.observations.end());
    frame.track_begins.push_back(frame.observations.size());
    ++num_merged_[track.frame_idx];
  }
}

void StaticPoints::PutBack(Scene* scene) const {
  if (!tracks_) return;
  for (size_t f = 0; f < scene->frames.size(); ++f) {
    Frame& frame = scene->frames[f];
    frame.points.resize(frame.points.size() - num_merged_[f]);
    frame.track_begins.resize(frame.points.size() + 1);
    frame.observations.resize(frame.track_begins.back());
  }
  tracks_->PutBack(scene);
}

void StaticPoints::FitPoints(const MultiFrameOptions& options,
                             const Scene& refined) {
  if (tracks_) tracks_->FitPoints(options, refined);
}

}  // namespace mfir
