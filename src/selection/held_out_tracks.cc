#include "src/selection/held_out_tracks.h"

#include <cmath>
#include <cstdint>
#include <utility>

namespace mfir {
namespace {

constexpr uint64_t kHashBasis = 14695981039346656037u;

// FNV-1a.
uint64_t Hash(uint64_t hash, const void* data, size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  for (size_t i = 0; i < size; ++i) {
    hash = (hash ^ bytes[i]) * 1099511628211u;
  }
  return hash;
}

// The last digits of a keypoint must not change the choice. Many keypoints are
// binary or decimal fractions: none of these is where rounding goes up or down.
int64_t HundredthsOfPixel(double coordinate) {
  return std::llround(100.0 * coordinate + 0.1234567891);
}

// Depends on the keypoints of the track alone: files that differ in order or in
// the names of images and frames must hold out the same tracks.
bool IsHeldOut(double share, const Observation* begin, const Observation* end) {
  uint64_t sum = 0;
  for (const Observation* observation = begin; observation != end;
       ++observation) {
    const int64_t key[] = {HundredthsOfPixel(observation->xy.x()),
                           HundredthsOfPixel(observation->xy.y())};
    sum += Hash(kHashBasis, key, sizeof(key));
  }
  const uint64_t hash = Hash(kHashBasis, &sum, sizeof(sum));
  return static_cast<double>(hash >> 11) * 0x1.0p-53 < share;
}

}  // namespace

Selection HoldOutTracks(double share, const Scene& scene, Selection selection) {
  const Selection all = selection;
  bool is_any_left = false;
  const auto hold_out =
      [&](const Observation* begin, const Observation* end, TrackRole* role) {
        if (*role != TrackRole::kFitted) return;
        if (IsHeldOut(share, begin, end)) {
          *role = TrackRole::kHeldOut;
        } else {
          is_any_left = true;
        }
      };
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    const Observation* observations = frame.observations.data();
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      hold_out(observations + frame.track_begins[i],
               observations + frame.track_begins[i + 1],
               &selection.roles[f][i]);
    }
  }
  for (MergedTrack& track : selection.merged) {
    const Observation* begin = track.observations.data();
    hold_out(begin, begin + track.observations.size(), &track.role);
  }
  return Any(*scene.ranks, is_any_left) ? selection : all;
}

}  // namespace mfir
