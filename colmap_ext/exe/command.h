// What all our commands share.

#pragma once

#include <functional>

#include "src/parallel/communicator.h"

namespace mfir {

// Runs the body of a command and turns exceptions into a message on stderr and
// the exit code of the contract (src/util/errors.h). Ctrl-C and SIGTERM end it
// with 130 and 143 (src/util/interruption.h).
int RunCommand(const std::function<void()>& body);

// The same for a command that can work as several processes (mpirun). If some
// fail, one says why, and all end with its exit code.
int RunCommandOverRanks(const std::function<void(const Communicator&)>& body);

// In FRAMES: the frames that the triangulator has taken by max_num_frames.
constexpr const char* kFrameListName = "frame_list.txt";

int RunMultiFrameAutomaticRefiner(int argc, char** argv);
int RunMultiFrameIntrinsicsRefiner(int argc, char** argv);
int RunMultiFrameEvaluator(int argc, char** argv);
int RunMultiFrameReporter(int argc, char** argv);
int RunMultiFrameRigConverter(int argc, char** argv);
int RunMultiFrameSimulator(int argc, char** argv);
int RunMultiFrameTriangulator(int argc, char** argv);

}  // namespace mfir
