// Which tracks of a scene are fitted, and what becomes of the others.

#pragma once

#include <cstddef>
#include <vector>

#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

enum class TrackRole {
  kFitted,
  kHeldOut,  // to check the result
  kMerged,   // a merged track takes its place, with those of other frames
  kDropped,
};

// Takes the place of the tracks of a static point. Its start is the point of
// the scene's track `point_idx` in the same frame.
struct MergedTrack {
  size_t frame_idx = 0;
  size_t point_idx = 0;
  std::vector<Observation> observations;
  TrackRole role = TrackRole::kFitted;  // or kHeldOut
};

// Says of each track of a scene what it is for.
struct Selection {
  std::vector<std::vector<TrackRole>> roles;  // by frame and point
  std::vector<MergedTrack> merged;
};

// All are fitted.
Selection FittedTracks(const Scene& scene);

// The tracks of `role`, in their order, then merged ones of that role, with the
// cameras and images of `scene` and `estimate`.
SceneEstimate SelectTracks(const Selection& selection,
                           TrackRole role,
                           const Scene& scene,
                           const Estimate& estimate,
                           int num_threads = -1);

// The estimate of all tracks of the scene with the points of the tracks of
// `role` from `selected`, an estimate of what SelectTracks gives for that role,
// and its cameras and images. Points of merged tracks are left out.
Estimate JoinEstimates(const Selection& selection,
                       TrackRole role,
                       const Estimate& selected,
                       Estimate all);

}  // namespace mfir
