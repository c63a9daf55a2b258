// Tracks so near each other that their keypoints come from the same pixels.

#pragma once

#include <vector>

#include "src/scene/scene.h"

namespace mfir {

// Groups of tracks with common errors: `static_points` (see
// static_point_search.h), joined with tracks of the same frame next to them.
// Patches and descriptors of neighbouring keypoints overlap: the noise of these
// pixels, and what the surface there has that no plane has, is in both. Tracks
// on their own are in no group.
//
// A track joins the group of the earlier track whose keypoints are within 10 px
// of its own in most cameras, at least two of them, that see both: no chains,
// which would join whole surfaces. Linear in the number of observations.
// For a scene of one process: see FindOverRanks (static_point_search.h).
//
// The 10 px: on panoptic31, with refined keypoints, residuals of two tracks in
// the same image have a correlation of 0.39 up to 3 px apart, 0.20 up to 6 px,
// 0.10 up to 10 px and 0.05 up to 15 px.
std::vector<std::vector<TrackIndex>> GroupOverlappingTracks(
    const Scene& scene,
    const std::vector<std::vector<TrackIndex>>& static_points,
    int num_threads = -1);

}  // namespace mfir
