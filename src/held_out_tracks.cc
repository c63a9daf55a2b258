#include "held_out_tracks.h"

#include <cmath>
#include <cstdint>

#include "noise_samples.h"
#include "refinement.h"

namespace mfir {
namespace {

// FNV-1a.
uint64_t Hash(uint64_t hash, const void* data, size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  for (size_t i = 0; i < size; ++i) {
    hash = (hash ^ bytes[i]) * 1099511628211u;
  }
  return hash;
}

bool IsHeldOut(double share, const Frame& frame, size_t point_idx) {
  uint64_t hash =
      Hash(14695981039346656037u, frame.name.data(), frame.name.size());
  for (size_t k = frame.track_begins[point_idx];
       k < frame.track_begins[point_idx + 1];
       ++k) {
    // To a hundredth of a pixel: rounding must not change the choice.
    const int64_t key[] = {std::llround(100.0 * frame.observations[k].xy.x()),
                           std::llround(100.0 * frame.observations[k].xy.y())};
    hash = Hash(hash, key, sizeof(key));
  }
  return static_cast<double>(hash >> 11) * 0x1.0p-53 < share;
}

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

HeldOutTracks::HeldOutTracks(double share, Scene* scene) {
  held_out_.cameras = scene->cameras;
  for (Frame& frame : scene->frames) {
    Frame kept = WithoutTracks(frame);
    Frame held_out = WithoutTracks(frame);
    is_held_out_.emplace_back();
    for (size_t i = 0; i < frame.points.size(); ++i) {
      is_held_out_.back().push_back(IsHeldOut(share, frame, i));
      AppendTrack(frame, i, is_held_out_.back()[i] ? &held_out : &kept);
    }
    held_out_.frames.push_back(std::move(held_out));
    frame = std::move(kept);
  }
}

double HeldOutTracks::Evaluate(const MultiFrameOptions& options,
                               const Scene& refined) {
  held_out_.cameras = refined.cameras;
  for (size_t i = 0; i < held_out_.frames.size(); ++i) {
    held_out_.frames[i].images = refined.frames[i].images;
  }
  // Only the points are free.
  MultiFrameOptions points_only = options;
  points_only.refine_focal_length = false;
  points_only.refine_principal_point = false;
  points_only.refine_extra_params = false;
  points_only.extrinsics_rotation_std_deg = 0.0;
  points_only.extrinsics_translation_std = 0.0;
  RefineFixedExtrinsics(
      points_only, true, [](const Stage&) {}, &held_out_);
  return InlierRms(SquaredResiduals(held_out_, options.SingleFrameMode()));
}

void HeldOutTracks::PutBack(Scene* scene) const {
  for (size_t f = 0; f < scene->frames.size(); ++f) {
    Frame& frame = scene->frames[f];
    Frame merged = WithoutTracks(frame);
    size_t next_kept = 0;
    size_t next_held_out = 0;
    for (const bool is_held_out : is_held_out_[f]) {
      if (is_held_out) {
        AppendTrack(held_out_.frames[f], next_held_out++, &merged);
      } else {
        AppendTrack(frame, next_kept++, &merged);
      }
    }
    frame = std::move(merged);
  }
}

}  // namespace mfir
