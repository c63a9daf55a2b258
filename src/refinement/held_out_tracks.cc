#include "src/refinement/held_out_tracks.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include "src/refinement/refinement.h"
#include "src/scene/residual_statistics.h"

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
// the names of images must hold out the same tracks.
bool IsHeldOut(double share, const Frame& frame, size_t point_idx) {
  uint64_t sum = 0;
  for (size_t k = frame.track_begins[point_idx];
       k < frame.track_begins[point_idx + 1];
       ++k) {
    const Observation& observation = frame.observations[k];
    const int64_t key[] = {HundredthsOfPixel(observation.xy.x()),
                           HundredthsOfPixel(observation.xy.y())};
    sum += Hash(kHashBasis, key, sizeof(key));
  }
  const uint64_t hash =
      Hash(Hash(kHashBasis, frame.name.data(), frame.name.size()),
           &sum,
           sizeof(sum));
  return static_cast<double>(hash >> 11) * 0x1.0p-53 < share;
}

// None where nothing would be left to refine with.
std::vector<std::vector<bool>> ChooseHeldOut(double share, const Scene& scene) {
  std::vector<std::vector<bool>> is_held_out(scene.frames.size());
  bool is_any_left = false;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    for (size_t i = 0; i < scene.frames[f].points.size(); ++i) {
      is_held_out[f].push_back(IsHeldOut(share, scene.frames[f], i));
      is_any_left = is_any_left || !is_held_out[f].back();
    }
  }
  if (!is_any_left) {
    for (std::vector<bool>& frame : is_held_out) {
      frame.assign(frame.size(), false);
    }
  }
  return is_held_out;
}

}  // namespace

HeldOutTracks::HeldOutTracks(double share, Scene* scene)
    : tracks_(ChooseHeldOut(share, *scene), scene) {}

double HeldOutTracks::Evaluate(const MultiFrameOptions& options,
                               const Scene& refined) {
  tracks_.FitPoints(options, refined);
  return InlierRms(
      SquaredResiduals(tracks_.Tracks(), options.SingleFrameMode()));
}

}  // namespace mfir
