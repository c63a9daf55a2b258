// Cameras of a simulated capture: poses on a dome, true and drifted intrinsics.

#pragma once

#include <vector>

#include "colmap_ext/options/simulator_options.h"
#include "src/scene/scene.h"
#include "src/util/random.h"

namespace mfir {

// What the random numbers of a capture are for: second part of their key, after
// the seed (SyntheticSurface has 1 and 2).
enum RandomStream : uint64_t {
  kTrueCameraStream = 10,  // camera
  kKnownCameraStream,      // camera
  kPresenceStream,         // frame
  kPointStream,            // frame
  kKeypointStream,         // frame, camera
  kDriftStream,            // frame, camera
  kGaugeStream,            // frame
  kImageStream,            // frame, camera
};

// World units per metre.
double UnitsPerMetre(const SimulatorOptions& options);

// options.focal_length, or the one with which the head fills the image; pixels.
double NominalFocalLength(const SimulatorOptions& options);

// The cameras as they are.
std::vector<RigCamera> MakeTrueCameras(const SimulatorOptions& options);

// The cameras as RIG has them: `true_cameras` with the errors of options.rig_*
// and drifted intrinsics.
std::vector<RigCamera> MakeKnownCameras(
    const SimulatorOptions& options,
    const std::vector<RigCamera>& true_cameras);

// `camera`'s intrinsics with random errors of the size of options.initial_*.
std::vector<double> DriftIntrinsics(const SimulatorOptions& options,
                                    const RigCamera& camera,
                                    Random* random);

}  // namespace mfir
