// The files that a run has read, for its summary.

#pragma once

#include <nlohmann/json.hpp>

#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/frames/frames.h"

namespace mfir {

// [{"path", "bytes", "sha256"}]: RIG, ground truth, lists, networks and the
// models of the used frames; databases without a hash (null), they are large.
// Files that have vanished are left out.
nlohmann::ordered_json DescribeFiles(const RefinerOptions& options,
                                     const Capture& capture);

}  // namespace mfir
