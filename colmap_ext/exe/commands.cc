// The commands this extension adds to the `colmap` program.

#include "colmap_ext/exe/command.h"
#include "colmap_ext/host/extension.h"

namespace {
using namespace mfir;  // NOLINT: the macro needs plain names
COLMAP_REGISTER_COMMAND("multi_frame_automatic_refiner",
                        RunMultiFrameAutomaticRefiner);
COLMAP_REGISTER_COMMAND("multi_frame_evaluator", RunMultiFrameEvaluator);
COLMAP_REGISTER_COMMAND("multi_frame_intrinsics_refiner",
                        RunMultiFrameIntrinsicsRefiner);
COLMAP_REGISTER_COMMAND("multi_frame_reporter", RunMultiFrameReporter);
COLMAP_REGISTER_COMMAND("multi_frame_rig_converter", RunMultiFrameRigConverter);
COLMAP_REGISTER_COMMAND("multi_frame_simulator", RunMultiFrameSimulator);
COLMAP_REGISTER_COMMAND("multi_frame_triangulator", RunMultiFrameTriangulator);
}  // namespace
