#include "src/refinement/tracks_apart.h"

#include <utility>

#include "src/refinement/refinement.h"

namespace mfir {
namespace {

void AppendTrack(const Frame& source, size_t point_idx, Frame* target) {
  target->points.push_back(source.points[point_idx]);
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

TracksApart::TracksApart(std::vector<std::vector<bool>> is_apart, Scene* scene)
    : is_apart_(std::move(is_apart)) {
  tracks_.cameras = scene->cameras;
  for (size_t f = 0; f < scene->frames.size(); ++f) {
    Frame& frame = scene->frames[f];
    Frame kept = WithoutTracks(frame);
    Frame apart = WithoutTracks(frame);
    for (size_t i = 0; i < frame.points.size(); ++i) {
      AppendTrack(frame, i, is_apart_[f][i] ? &apart : &kept);
    }
    tracks_.frames.push_back(std::move(apart));
    frame = std::move(kept);
  }
}

void TracksApart::FitPoints(const MultiFrameOptions& options,
                            const Scene& refined) {
  tracks_.cameras = refined.cameras;
  for (size_t i = 0; i < tracks_.frames.size(); ++i) {
    tracks_.frames[i].images = refined.frames[i].images;
  }
  // Only the points are free.
  MultiFrameOptions points_only = options;
  points_only.refine_focal_length = false;
  points_only.refine_principal_point = false;
  points_only.refine_extra_params = false;
  points_only.extrinsics_rotation_std_deg = 0.0;
  points_only.extrinsics_translation_std = 0.0;
  RefineFixedExtrinsics(
      points_only, true, [](const Stage&) {}, &tracks_);
}

void TracksApart::PutBack(Scene* scene) const {
  for (size_t f = 0; f < scene->frames.size(); ++f) {
    Frame& frame = scene->frames[f];
    Frame merged = WithoutTracks(frame);
    size_t next_kept = 0;
    size_t next_apart = 0;
    for (const bool is_apart : is_apart_[f]) {
      if (is_apart) {
        AppendTrack(tracks_.frames[f], next_apart++, &merged);
      } else {
        AppendTrack(frame, next_kept++, &merged);
      }
    }
    frame = std::move(merged);
  }
}

}  // namespace mfir
