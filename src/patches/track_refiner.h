// Tracks that are aligned and completed together, see track_refinement.h.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_backend.h"
#include "src/patches/track_refinement.h"

namespace mfir {

inline bool IsGood(PatchOutcome outcome) {
  return outcome == PatchOutcome::kReference ||
         outcome == PatchOutcome::kAligned || outcome == PatchOutcome::kAdded;
}

// Of one frame; several threads may use it at once.
class TrackRefiner {
 public:
  TrackRefiner(const TrackRefinementOptions& options,
               const std::vector<PatchCamera>& cameras,
               const std::vector<SplineImage>& images);

  // `count` tracks with the outcomes of all their observations, and new ones
  // after these. One step of all tracks at a time, so that a GPU has enough to
  // do; the result of a track does not depend on the others. The backend has
  // the images.
  void Refine(const PatchTrack* tracks,
              size_t count,
              int num_threads,
              PatchBackend* backend,
              RefinedTrack* refined) const;

 private:
  const TrackRefinementOptions& options_;
  const std::vector<PatchCamera>& cameras_;
  const std::vector<SplineImage>& images_;
  std::vector<Eigen::Vector3d> centers_;
};

}  // namespace mfir
