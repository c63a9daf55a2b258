// COLMAP's triangulation of the verified matches of a database.

#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "colmap_ext/host/database.h"
#include "colmap_ext/host/reconstruction.h"

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/sfm/incremental_triangulator.h"
#else
#include "sfm/incremental_triangulator.h"
#endif

namespace mfir::host {

using TriangulatorOptions = colmap::IncrementalTriangulator::Options;

struct TriangulationOptions {
  TriangulatorOptions triangulator;
  size_t min_num_matches = 15;  // of a pair of images
  bool ignore_watermarks = false;
  double filter_max_reproj_error = 4.0;  // pixels
  double filter_min_tri_angle = 1.5;     // degrees
};

// Triangulates the images in this order, all registered in `reconstruction`,
// then completes, merges and filters the tracks: the steps of COLMAP's
// point_triangulator without its bundle adjustment. RANSAC begins with the same
// random numbers each time.
void TriangulateImages(const TriangulationOptions& options,
                       const Database& database,
                       const std::vector<image_t>& image_ids,
                       Reconstruction* reconstruction);

}  // namespace mfir::host
