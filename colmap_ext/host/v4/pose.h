// Poses as COLMAP 4 has them.

#pragma once

#include "colmap/geometry/rigid3.h"
#include "src/geometry/rigid3.h"

namespace mfir::host {

inline colmap::Rigid3d ToColmap(const Rigid3& pose) {
  return colmap::Rigid3d(pose.rotation, pose.translation);
}

}  // namespace mfir::host
