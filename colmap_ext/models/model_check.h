// What COLMAP's reader takes for granted about the files of a sparse model,
// checked before it runs: it aborts, hangs or misreads otherwise.

#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/host/reconstruction.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// Paths of a model's files, all binary or all text.
struct ModelFiles {
  bool is_binary = true;
  std::string cameras;
  std::string images;
  std::string points3D;  // empty: there is none
};

// Checks structure, identifiers, quaternions (which the reader normalizes), and
// that tracks name observations of their points.
// Returns the number of images. Throws InputError naming file and entry, or
// file and line ("images.txt:12: ..."). What is read are the `copies`, which
// may be the files themselves.
size_t CheckBinaryModel(const ModelFiles& files, const ModelFiles& copies);
size_t CheckTextModel(const ModelFiles& files, const ModelFiles& copies);

[[noreturn]] void FailModel(const std::string& path,
                            const std::string& entry,
                            const std::string& what);

// What makes `coordinates` (world units) damage rather than a position or
// translation; empty if nothing.
std::string CoordinateProblem(const Eigen::Vector3d& coordinates);

// What makes `params` damage rather than the parameters of a camera: not
// finite, focal lengths that are not positive, focal lengths or principal
// points beyond 1e7 px; empty if nothing.
std::string IntrinsicsProblem(const CameraModel& model,
                              const std::vector<double>& params);

// Checks the values of a model that was read from `files`: finite, plausible,
// observations in the tracks of their points. Throws InputError naming the file
// and the camera, image or point.
void CheckModelValues(const ModelFiles& files,
                      const host::Reconstruction& reconstruction);

}  // namespace mfir
