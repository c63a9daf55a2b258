// Tracks that take no part in a refinement, to check its result.

#pragma once

#include "src/refinement/options.h"
#include "src/refinement/tracks_apart.h"
#include "src/scene/scene.h"

namespace mfir {

class HeldOutTracks {
 public:
  // Takes about `share` of the tracks out of the scene. The choice depends on
  // the frame's name and the track's own keypoints only, not on any order.
  HeldOutTracks(double share, Scene* scene);

  // Intersects the tracks with the intrinsics and extrinsics of the refined
  // scene, which stay as they are. Returns the RMS (px) of the residual norms
  // without outliers (InlierRms); NaN without tracks.
  double Evaluate(const MultiFrameOptions& options, const Scene& refined);

  // Puts the tracks back where they were.
  void PutBack(Scene* scene) const { tracks_.PutBack(scene); }

 private:
  TracksApart tracks_;
};

}  // namespace mfir
