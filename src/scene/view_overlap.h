// Which cameras of a rig can see the same things, from geometry alone.

#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "src/scene/scene.h"

namespace mfir {

struct ViewOverlapOptions {
  // Largest angle (degrees) between the two lines of sight to a point. Beyond
  // about 60 degrees the patches around it do not look alike any more.
  double max_view_angle = 60.0;
  // Smallest share of each image that the other camera sees, at the depth
  // where it is largest.
  double min_overlap = 0.1;
};

// Share of the pixels of `camera` whose ray, cut off at the distance `depth`,
// ends in the image of `other` and is seen from there under an angle of no more
// than `max_view_angle` degrees.
double ViewOverlap(const RigCamera& camera,
                   const RigCamera& other,
                   double depth,
                   double max_view_angle);

// Pairs (i, j), i < j, of cameras that overlap at some depth. The scene is not
// known: depths go from 1/8 to 16 times the size of the rig (rms distance of
// the camera centres from their mean), which makes the result independent of
// its units. Throws InputError if all cameras are at the same place.
std::vector<std::pair<size_t, size_t>> SelectOverlappingPairs(
    const ViewOverlapOptions& options,
    const std::vector<RigCamera>& cameras,
    int num_threads);

}  // namespace mfir
