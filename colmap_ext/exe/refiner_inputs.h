// What the refiner reads before it computes anything.

#pragma once

#include <ostream>
#include <vector>

#include <nlohmann/json.hpp>

#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/io/output_folder.h"
#include "colmap_ext/refinement/refiner_progress.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/evaluation/evaluation.h"
#include "src/scene/scene.h"

namespace mfir {

struct RefinerInputs {
  Rig rig;
  std::vector<CameraIntrinsics> true_cameras;  // empty without a ground truth
  // Aligned, in coordinates in which the array has unit size around the origin.
  Capture capture;
};

// Reads RIG, the ground truth and the frames, and aligns the frames to RIG.
// Logs and warns of what is left out. Throws InputError, UsageError, and
// OutputError where `output` would replace an input.
RefinerInputs ReadInputs(const RefinerOptions& options,
                         const Communicator& ranks,
                         const OutputFolder& output,
                         Progress* progress);

// Where the refinement starts: the frames' own points and poses, and the
// intrinsics of the frames or of RIG. Throws InputError for intrinsics or a
// ground truth that does not fit the cameras.
Start MakeStart(const RefinerOptions& options, const RefinerInputs& inputs);

// The field `inputs` of summary.json.
nlohmann::ordered_json DescribeInputs(const RefinerOptions& options,
                                      const Rig& rig,
                                      const Capture& capture);

// Errors against the ground truth; null without one. Printed to `report` unless
// that is null. Throws InputError if the truth has not the same cameras.
nlohmann::ordered_json EvaluateCameras(
    const std::vector<CameraIntrinsics>& truth,
    const std::vector<RigCamera>& cameras,
    std::ostream* report);

}  // namespace mfir
