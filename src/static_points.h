// Static background: points that are in place in several frames. Each frame
// that shows them repeats the same measurement, with the same errors of the
// keypoints, so that the frames are no independent evidence.

#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "options.h"
#include "scene.h"
#include "tracks_apart.h"

namespace mfir {

struct TrackIndex {
  size_t frame_idx = 0;
  size_t point_idx = 0;
};

// Groups of tracks that show the same static point in two frames or more, each
// in the order of the frames. A track belongs to a point that earlier frames
// have shown if in at least two cameras, and in most of the cameras they share,
// the keypoints agree within a pixel with those of the first frame that has
// them. Linear in the number of observations.
//
// The pixel: on panoptic31 the distances of keypoints from the nearest in the
// next frame have a peak (16 % below 0.3 px), which at 2 px has sunk to the
// flat background of 0.002 per px^2. Where each frame is moved on by 0.1 to
// 0.3 m, 0.1 % of the tracks at most are taken for static instead of 30 %.
std::vector<std::vector<TrackIndex>> FindStaticPoints(const Scene& scene);

// Takes repeated measurements of static points out of a refinement.
class StaticPoints {
 public:
  // "merge": one track takes the place of those of a static point, with the
  // median of their keypoints in each camera. It is the last of a frame that
  // has images of most of its cameras, and among those the one that sees it in
  // most, the first of several. "drop": no track of a static point takes part.
  // "keep": the scene stays as it is.
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
