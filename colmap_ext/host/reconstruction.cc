#include "colmap_ext/host/reconstruction.h"

#include <cmath>

namespace mfir::host {
namespace {

// As COLMAP 3.8 does: the same bits in all versions.
Eigen::Vector4d Normalized(const Eigen::Vector4d& qvec) {
  return qvec / qvec.norm();
}

}  // namespace

Eigen::Quaterniond StableQuaternion(const Eigen::Quaterniond& q) {
  const auto is_stable = [](const Eigen::Vector4d& qvec) {
    return Normalized(qvec) == qvec;
  };
  Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
  for (int i = 0; i < 3 && !is_stable(qvec); ++i) {
    qvec = Normalized(qvec);
  }
  // About 1 % of all rotations alternate between neighbours for ever. Then a
  // component is moved by a few units in the last place.
  Eigen::Vector4d candidate = qvec;
  for (int num_ulps = 1; num_ulps <= 4 && !is_stable(candidate); ++num_ulps) {
    for (int i = 0; i < 8 && !is_stable(candidate); ++i) {
      candidate = qvec;
      for (int j = 0; j < num_ulps; ++j) {
        candidate(i / 2) =
            std::nextafter(candidate(i / 2), i % 2 == 0 ? 2.0 : -2.0);
      }
    }
  }
  return Eigen::Quaterniond(
      candidate(0), candidate(1), candidate(2), candidate(3));
}

}  // namespace mfir::host
