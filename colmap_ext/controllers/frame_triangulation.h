// From the matches of a frame to its sparse model, with known extrinsics.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/controllers/frame_verification.h"
#include "colmap_ext/frames/frame_database.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

// Triangulates the frame of an opened database. Unless the database has
// two-view geometries, its images are matched along the epipolar lines of
// `cameras` (their extrinsics, and the intrinsics to start from): those pairs
// that have matches, or, where none has, `pairs` (of cameras). See
// VerifyMatches, which counts in `progress`. Images are found in the database
// by camera name; those without camera of the rig are left out and reported in
// `warnings`.
//
// The model has one camera per image, id = index into `cameras` + 1.
// Throws InputError: fewer than two images, two images of a camera, image sizes
// that are not those of the cameras, no verified pair, no point.
host::Reconstruction TriangulateFrame(
    const TriangulatorOptions& options,
    const CameraNaming& naming,
    const std::vector<RigCamera>& cameras,
    const std::vector<std::pair<size_t, size_t>>& pairs,
    int num_threads,
    const ProgressFunction& progress,
    host::Database* database,
    FrameStatistics* statistics,
    FrameTimings* timings,
    std::vector<std::string>* warnings);

}  // namespace mfir
