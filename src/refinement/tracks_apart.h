// Tracks taken out of a scene for a time.

#pragma once

#include <vector>

#include "src/refinement/options.h"
#include "src/scene/scene.h"

namespace mfir {

class TracksApart {
 public:
  // Takes the tracks out for which is_apart[frame][point] is true.
  TracksApart(std::vector<std::vector<bool>> is_apart, Scene* scene);

  // The tracks in frames of their own, with the intrinsics and extrinsics of
  // the last FitPoints.
  const Scene& Tracks() const { return tracks_; }

  // Intersects the tracks with the intrinsics and extrinsics of the refined
  // scene, which stay as they are.
  void FitPoints(const MultiFrameOptions& options, const Scene& refined);

  // Puts the tracks back where they were.
  void PutBack(Scene* scene) const;

 private:
  Scene tracks_;
  std::vector<std::vector<bool>> is_apart_;  // by frame and original point
};

}  // namespace mfir
