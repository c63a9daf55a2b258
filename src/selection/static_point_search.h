// Static background: points that are in place in several frames. Each frame
// that shows them repeats the same measurement, with the same errors of the
// keypoints, so that the frames are no independent evidence.

#pragma once

#include <functional>
#include <vector>

#include "src/scene/scene.h"

namespace mfir {

// Tracks that belong together, each group in the order of the frames.
using TrackGroups = std::vector<std::vector<TrackIndex>>;

// What finds groups of tracks in a scene of one process.
using FindGroups = std::function<TrackGroups(const Scene&)>;

// The groups that `find` gives for the frames of all ranks: the same groups on
// all, in the same order, each with the tracks of this rank only, if any. The
// first rank searches; it holds the keypoints of all frames meanwhile, and
// nothing else of them.
TrackGroups FindOverRanks(const Scene& scene, const FindGroups& find);

// Tracks that show the same static point in two frames or more. A track belongs
// to a point that one of the kMaxStaticGap frames before has shown if in at
// least two cameras, and in most of the cameras they share, the keypoints agree
// within a pixel with those of the first frame that has them. Linear in the
// number of observations; the same for all numbers of threads (-1: all of the
// machine).
//
// The pixel: on panoptic31 the distances of keypoints from the nearest in the
// next frame have a peak (16 % below 0.3 px), which at 2 px has sunk to the
// flat background of 0.002 per px^2. Where each frame is moved on by 0.1 to
// 0.3 m, 0.1 % of the tracks at most are taken for static instead of 30 %.
//
// Over ranks as FindOverRanks.
inline constexpr size_t kMaxStaticGap = 16;
TrackGroups FindStaticPoints(const Scene& scene, int num_threads = -1);

}  // namespace mfir
