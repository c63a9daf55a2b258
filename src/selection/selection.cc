#include "src/selection/selection.h"

#include <utility>

#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

void AppendTrack(const Frame& source, size_t point_idx, Frame* target) {
  target->observations.insert(
      target->observations.end(),
      source.observations.begin() + source.track_begins[point_idx],
      source.observations.begin() + source.track_begins[point_idx + 1]);
  target->track_begins.push_back(target->observations.size());
}

Frame WithoutTracks(const Frame& frame) {
  Frame empty;
  empty.name = frame.name;
  empty.images = frame.images;
  empty.cost_maps = frame.cost_maps;
  empty.feature_keypoints = frame.feature_keypoints;
  return empty;
}

}  // namespace

Selection FittedTracks(const Scene& scene) {
  Selection selection;
  for (const Frame& frame : scene.frames) {
    selection.roles.emplace_back(frame.NumPoints(), TrackRole::kFitted);
  }
  return selection;
}

SceneEstimate SelectTracks(const Selection& selection,
                           TrackRole role,
                           const Scene& scene,
                           const Estimate& estimate,
                           int num_threads) {
  SceneEstimate selected;
  selected.scene.ranks = scene.ranks;
  selected.scene.cameras = scene.cameras;
  selected.estimate.cameras = estimate.cameras;
  selected.scene.frames.resize(scene.frames.size());
  selected.estimate.frames.resize(scene.frames.size());
  ParallelFor(scene.frames.size(), num_threads, [&](size_t f) {
    const Frame& frame = scene.frames[f];
    Frame& selected_frame = selected.scene.frames[f];
    selected_frame = WithoutTracks(frame);
    FrameEstimate& frame_estimate = selected.estimate.frames[f];
    frame_estimate.images = estimate.frames[f].images;
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      if (selection.roles[f][i] != role) continue;
      AppendTrack(frame, i, &selected_frame);
      frame_estimate.points.push_back(estimate.frames[f].points[i]);
    }
  });
  for (const MergedTrack& track : selection.merged) {
    if (track.role != role) continue;
    Frame& frame = selected.scene.frames[track.frame_idx];
    frame.observations.insert(frame.observations.end(),
                              track.observations.begin(),
                              track.observations.end());
    frame.track_begins.push_back(frame.observations.size());
    selected.estimate.frames[track.frame_idx].points.push_back(
        estimate.frames[track.frame_idx].points[track.point_idx]);
  }
  return selected;
}

Estimate JoinEstimates(const Selection& selection,
                       TrackRole role,
                       const Estimate& selected,
                       Estimate all) {
  all.cameras = selected.cameras;
  for (size_t f = 0; f < all.frames.size(); ++f) {
    const FrameEstimate& frame = selected.frames[f];
    all.frames[f].images = frame.images;
    size_t next = 0;
    for (size_t i = 0; i < selection.roles[f].size(); ++i) {
      if (selection.roles[f][i] == role) {
        all.frames[f].points[i] = frame.points[next++];
      }
    }
  }
  return all;
}

}  // namespace mfir
