// The option static_points: what becomes of the tracks of static points
// (static_point_search.h) in a refinement.

#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "src/refinement/options.h"
#include "src/refinement/tracks_apart.h"
#include "src/scene/scene.h"

namespace mfir {

// Takes repeated measurements of static points out of a refinement.
class StaticPoints {
 public:
  // "merge": one track takes the place of those of a static point, with the
  // median of their keypoints in each camera. It is the last of a frame that
  // has images of most of its cameras, and among those the one that sees it in
  // most, the first of several. "drop": no track of a static point takes part.
  // "keep": the scene stays as it is; RefineFixedExtrinsics takes the tracks of
  // a static point for one piece of evidence in the covariance.
  //
  // Throws InputError if "drop" leaves nothing.
  StaticPoints(const std::string& treatment, Scene* scene);

  // Puts the tracks back where they were, in the stead of merged ones.
  void PutBack(Scene* scene) const;

  // Before PutBack: intersects the tracks that took no part with the intrinsics
  // and extrinsics of the refined scene.
  void FitPoints(const MultiFrameOptions& options, const Scene& refined);

  size_t NumPoints() const { return num_points_; }
  // That show static points, in all frames.
  size_t NumTracks() const { return num_tracks_; }
  // Share of the observations that show static points.
  double ObservationShare() const { return observation_share_; }

 private:
  size_t num_points_ = 0;
  size_t num_tracks_ = 0;
  double observation_share_ = 0.0;
  std::optional<TracksApart> tracks_;  // empty: nothing was changed
  std::vector<size_t> num_merged_;     // by frame
};

}  // namespace mfir
