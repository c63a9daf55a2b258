#include "src/selection/static_points.h"

#include <cstdint>
#include <map>
#include <utility>

#include "src/selection/static_point_search.h"
#include "src/util/errors.h"
#include "src/util/median.h"

namespace mfir {
namespace {

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
    merged.frame_idx = track.frame_idx;
    merged.point_idx = track.point_idx;
    merged.observations = std::move(observations);
  }
  return merged;
}

size_t NumObservations(const Scene& scene) {
  size_t count = 0;
  for (const Frame& frame : scene.frames) count += frame.observations.size();
  return count;
}

}  // namespace

Selection SelectStaticPoints(const std::string& treatment,
                             const Scene& scene,
                             StaticPointStatistics* statistics,
                             int num_threads) {
  const TrackGroups points = FindStaticPoints(scene, num_threads);
  const TrackRole role = treatment == "keep"    ? TrackRole::kFitted
                         : treatment == "merge" ? TrackRole::kMerged
                                                : TrackRole::kDropped;
  Selection selection = FittedTracks(scene);
  size_t num_observations = 0;
  *statistics = StaticPointStatistics();
  statistics->num_points = points.size();
  for (const std::vector<TrackIndex>& tracks : points) {
    statistics->num_tracks += tracks.size();
    for (const auto& [frame_idx, point_idx] : tracks) {
      selection.roles[frame_idx][point_idx] = role;
      const Frame& frame = scene.frames[frame_idx];
      num_observations +=
          frame.track_begins[point_idx + 1] - frame.track_begins[point_idx];
    }
    if (role == TrackRole::kMerged) {
      selection.merged.push_back(MergeTracks(scene, tracks));
    }
  }
  const Communicator& ranks = *scene.ranks;
  statistics->num_tracks = Sum(ranks, statistics->num_tracks);
  num_observations = Sum(ranks, num_observations);
  const size_t num_all = Sum(ranks, NumObservations(scene));
  if (num_all > 0) {
    statistics->observation_share =
        static_cast<double>(num_observations) / static_cast<double>(num_all);
  }
  if (role == TrackRole::kDropped && num_observations == num_all &&
      !points.empty()) {
    throw InputError(
        "All tracks are in place in several frames, so that "
        "--MultiFrame.static_points drop leaves none. Use merge.");
  }
  return selection;
}

}  // namespace mfir
