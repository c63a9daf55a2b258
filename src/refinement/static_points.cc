#include "src/refinement/static_points.h"

#include <cstdint>
#include <map>
#include <utility>

#include "src/scene/static_point_search.h"
#include "src/util/errors.h"
#include "src/util/median.h"

namespace mfir {
namespace {

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
