#include "src/selection/static_point_search.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>

#include "src/parallel/parallel_for.h"
#include "src/scene/keypoint_grid.h"

namespace mfir {
namespace {

constexpr double kMaxDistance = 1.0;  // px
// Of the grid. Larger cells: fewer to look into, but more keypoints in each.
constexpr double kCellSize = 4.0;  // px
constexpr size_t kMinNumCameras = 2;
constexpr size_t kPointsPerChunk = 128;

struct Keypoint {
  size_t camera_idx;
  Eigen::Vector2d xy;
};

// One per camera, ascending.
void CollectKeypoints(const Frame& frame,
                      size_t point_idx,
                      std::vector<Keypoint>* keypoints) {
  keypoints->clear();
  for (size_t k = frame.track_begins[point_idx];
       k < frame.track_begins[point_idx + 1];
       ++k) {
    const Observation& observation = frame.observations[k];
    keypoints->push_back(
        {frame.images[observation.image_idx].camera_idx, observation.xy});
  }
  const auto is_before = [](const Keypoint& a, const Keypoint& b) {
    return a.camera_idx < b.camera_idx;
  };
  if (!std::is_sorted(keypoints->begin(), keypoints->end(), is_before)) {
    std::stable_sort(keypoints->begin(), keypoints->end(), is_before);
  }
  keypoints->erase(std::unique(keypoints->begin(),
                               keypoints->end(),
                               [](const Keypoint& a, const Keypoint& b) {
                                 return a.camera_idx == b.camera_idx;
                               }),
                   keypoints->end());
}

// Where the tracks of the frames so far have been, each place with the first
// keypoint in every camera. What grows with the tracks is in few large arrays:
// adding is the part of the search that threads cannot share.
class Places {
 public:
  explicit Places(size_t num_cameras)
      : num_words_((num_cameras + 63) / 64),
        grids_(num_cameras, KeypointGrid(kMaxDistance, kCellSize)),
        additions_(num_cameras) {}

  // Those that the track of a later frame shows, ascending.
  std::vector<size_t> Find(size_t frame_idx,
                           const Frame& frame,
                           size_t point_idx) const {
    thread_local std::vector<Keypoint> keypoints;
    thread_local std::vector<size_t> agreeing;
    CollectKeypoints(frame, point_idx, &keypoints);
    agreeing.clear();
    for (const Keypoint& keypoint : keypoints) {
      // Each place once.
      const size_t begin = agreeing.size();
      grids_[keypoint.camera_idx].ForEachNear(
          keypoint.xy, [&](size_t place_idx) {
            const size_t root = Root(place_idx);
            if (MayBeShown(root, frame_idx)) agreeing.push_back(root);
          });
      std::sort(agreeing.begin() + begin, agreeing.end());
      agreeing.erase(std::unique(agreeing.begin() + begin, agreeing.end()),
                     agreeing.end());
    }
    std::sort(agreeing.begin(), agreeing.end());
    std::vector<size_t> places;
    for (auto begin = agreeing.begin(); begin != agreeing.end();) {
      const auto end = std::upper_bound(begin, agreeing.end(), *begin);
      const size_t num_agreeing = static_cast<size_t>(end - begin);
      if (num_agreeing >= kMinNumCameras &&
          2 * num_agreeing > NumShared(*begin, keypoints)) {
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
    const size_t root =
        place_idxs.empty() ? AddPlace() : Root(place_idxs.front());
    for (const size_t idx : place_idxs) Unite(root, Root(idx));
    places_[root].last_frame_idx = track.frame_idx;
    const size_t idx = tracks_.size();
    tracks_.push_back({track, kNone});
    Append(idx, idx, &places_[root]);
    CollectKeypoints(frame, track.point_idx, &keypoints_);
    for (const Keypoint& keypoint : keypoints_) {
      if (Has(root, keypoint.camera_idx)) continue;
      Word(root, keypoint.camera_idx) |= Bit(keypoint.camera_idx);
      additions_[keypoint.camera_idx].push_back({keypoint.xy, root});
    }
  }

  // What was added can be found from now on.
  void FinishFrame(size_t frame_idx, int num_threads) {
    ParallelFor(grids_.size(), num_threads, [&](size_t i) {
      for (const auto& [xy, place_idx] : additions_[i]) {
        grids_[i].Add(xy, place_idx);
      }
      additions_[i].clear();
      // So that the search takes no longer in late frames than in early ones.
      if (frame_idx % kMaxStaticGap != kMaxStaticGap - 1) return;
      grids_[i].EraseIf([&](size_t place_idx) {
        return !MayBeShown(Root(place_idx), frame_idx + 1);
      });
    });
  }

  // Of the places with several.
  TrackGroups Tracks() const {
    TrackGroups groups;
    for (const Place& place : places_) {
      if (place.first == place.last) continue;
      std::vector<TrackIndex>& group = groups.emplace_back();
      for (size_t i = place.first; i != kNone; i = tracks_[i].next) {
        group.push_back(tracks_[i].track);
      }
    }
    return groups;
  }

 private:
  static constexpr size_t kNone = SIZE_MAX;

  struct PlacedTrack {
    TrackIndex track;
    size_t next;  // of the same place
  };

  // Its tracks, none where it has become part of another.
  struct Place {
    size_t first = kNone;
    size_t last = kNone;
    size_t last_frame_idx = 0;
  };

  // Puts the tracks from `first` to `last` behind those of the place.
  void Append(size_t first, size_t last, Place* place) {
    (place->first == kNone ? place->first : tracks_[place->last].next) = first;
    place->last = last;
  }

  bool MayBeShown(size_t root, size_t frame_idx) const {
    return places_[root].last_frame_idx + kMaxStaticGap >= frame_idx;
  }

  static uint64_t Bit(size_t camera_idx) {
    return uint64_t{1} << (camera_idx % 64);
  }

  uint64_t& Word(size_t place_idx, size_t camera_idx) {
    return cameras_[place_idx * num_words_ + camera_idx / 64];
  }

  bool Has(size_t place_idx, size_t camera_idx) const {
    return (cameras_[place_idx * num_words_ + camera_idx / 64] &
            Bit(camera_idx)) != 0;
  }

  size_t NumShared(size_t place_idx,
                   const std::vector<Keypoint>& keypoints) const {
    size_t count = 0;
    for (const Keypoint& keypoint : keypoints) {
      count += Has(place_idx, keypoint.camera_idx);
    }
    return count;
  }

  size_t Root(size_t place_idx) const {
    while (parents_[place_idx] != place_idx) place_idx = parents_[place_idx];
    return place_idx;
  }

  size_t AddPlace() {
    parents_.push_back(parents_.size());
    places_.emplace_back();
    cameras_.resize(cameras_.size() + num_words_, 0);
    return places_.size() - 1;
  }

  void Unite(size_t root, size_t other) {
    if (other == root) return;
    parents_[other] = root;
    const Place source = std::exchange(places_[other], {});
    Append(source.first, source.last, &places_[root]);
    for (size_t i = 0; i < num_words_; ++i) {
      cameras_[root * num_words_ + i] |= cameras_[other * num_words_ + i];
    }
  }

  std::vector<PlacedTrack> tracks_;
  // By place.
  std::vector<Place> places_;
  std::vector<size_t> parents_;    // of a root: itself
  std::vector<uint64_t> cameras_;  // num_words_ each, a bit per camera
  size_t num_words_;
  // By camera: the first keypoints of places.
  std::vector<KeypointGrid> grids_;
  // Of the frame at hand, by camera.
  std::vector<std::vector<std::pair<Eigen::Vector2d, size_t>>> additions_;
  std::vector<Keypoint> keypoints_;
};

// In the scene of one process.
TrackGroups FindInOneProcess(const Scene& scene, int num_threads) {
  if (scene.frames.size() < 2) return {};
  Places places(scene.cameras.size());
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    // Tracks of one frame are different points.
    std::vector<std::vector<size_t>> found(frame.NumPoints());
    const size_t num_chunks =
        (frame.NumPoints() + kPointsPerChunk - 1) / kPointsPerChunk;
    ParallelFor(num_chunks, num_threads, [&](size_t chunk) {
      const size_t begin = chunk * kPointsPerChunk;
      const size_t end = std::min(frame.NumPoints(), begin + kPointsPerChunk);
      for (size_t i = begin; i < end; ++i) found[i] = places.Find(f, frame, i);
    });
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      places.Add(found[i], {f, i}, frame);
    }
    places.FinishFrame(f, num_threads);
  }
  TrackGroups points;
  for (std::vector<TrackIndex>& tracks : places.Tracks()) {
    std::sort(tracks.begin(), tracks.end());
    if (tracks.front().frame_idx == tracks.back().frame_idx) continue;
    points.push_back(std::move(tracks));
  }
  return points;
}

// What the search needs of the tracks of a rank.
struct PackedObservation {
  size_t camera_idx;
  double xy[2];
};

std::string PackObservations(const Scene& scene) {
  std::vector<PackedObservation> packed;
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      packed.push_back({frame.images[observation.image_idx].camera_idx,
                        {observation.xy.x(), observation.xy.y()}});
    }
  }
  return std::string(reinterpret_cast<const char*>(packed.data()),
                     packed.size() * sizeof(PackedObservation));
}

// Appends the observations of a rank to frames that have their tracks, the
// images of which are the cameras.
void UnpackObservations(const std::string& bytes,
                        size_t* next_frame,
                        Scene* scene) {
  const char* data = bytes.data();
  while (data < bytes.data() + bytes.size()) {
    Frame& frame = scene->frames[(*next_frame)++];
    // None in frames without observations.
    frame.observations.resize(frame.track_begins.back());
    for (Observation& observation : frame.observations) {
      PackedObservation packed;
      std::memcpy(&packed, data, sizeof(packed));
      data += sizeof(packed);
      observation.image_idx = packed.camera_idx;
      observation.xy = {packed.xy[0], packed.xy[1]};
    }
  }
}

// The scene of all ranks on the first one, as far as the search needs it.
Scene GatherTracks(const Scene& scene) {
  const Communicator& ranks = *scene.ranks;
  std::vector<size_t> sizes;
  std::vector<size_t> lengths;
  for (const Frame& frame : scene.frames) {
    sizes.push_back(frame.NumPoints());
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      lengths.push_back(frame.track_begins[i + 1] - frame.track_begins[i]);
    }
  }
  sizes = Concatenate(ranks, sizes);
  lengths = Concatenate(ranks, lengths);
  Scene all;
  all.cameras = scene.cameras;
  size_t next = 0;
  for (const size_t num_points : sizes) {
    Frame& frame = all.frames.emplace_back();
    for (size_t i = 0; i < scene.cameras.size(); ++i) {
      frame.images.push_back({i});
    }
    for (size_t i = 0; i < num_points; ++i) {
      frame.track_begins.push_back(frame.track_begins.back() + lengths[next++]);
    }
  }
  size_t next_frame = 0;
  for (const std::string& bytes : ranks.Gather(PackObservations(scene))) {
    UnpackObservations(bytes, &next_frame, &all);
  }
  return all;
}

struct GroupedTrack {
  size_t group;
  TrackIndex track;
};

}  // namespace

TrackGroups FindOverRanks(const Scene& scene, const FindGroups& find) {
  const Communicator& ranks = *scene.ranks;
  if (ranks.IsAlone()) return find(scene);
  size_t first_frame = 0;
  const std::vector<size_t> num_frames =
      Concatenate(ranks, std::vector<size_t>{scene.frames.size()});
  for (int rank = 0; rank < ranks.Rank(); ++rank) {
    first_frame += num_frames[rank];
  }
  const Scene all = GatherTracks(scene);
  std::vector<GroupedTrack> tracks;
  if (ranks.IsFirst()) {
    const TrackGroups points = find(all);
    for (size_t g = 0; g < points.size(); ++g) {
      for (const TrackIndex& track : points[g]) tracks.push_back({g, track});
    }
  }
  TrackGroups points;
  for (const auto& [group, track] : Concatenate(ranks, tracks)) {
    points.resize(group + 1);
    if (track.frame_idx < first_frame ||
        track.frame_idx >= first_frame + scene.frames.size()) {
      continue;
    }
    points[group].push_back({track.frame_idx - first_frame, track.point_idx});
  }
  return points;
}

TrackGroups FindStaticPoints(const Scene& scene, int num_threads) {
  return FindOverRanks(scene, [num_threads](const Scene& all) {
    return FindInOneProcess(all, num_threads);
  });
}

}  // namespace mfir
