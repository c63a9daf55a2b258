// The processes that mpirun or srun have started together.

#pragma once

#include <memory>

#include "src/parallel/communicator.h"

namespace mfir {

// Ends the work of a rank because another one has failed, with the exit code
// that the run gets. That one has said why.
struct OtherRankFailed {
  int exit_code;
};

// A communicator between processes that can fail.
class ProcessGroup : public Communicator {
 public:
  // Of the processes, those on this machine.
  virtual int NumRanksOfMachine() const = 0;

  // Once all ranks have come to their ends: whether this one speaks for those
  // that have failed. `exit_code`: 0 if it has not. Sets the exit code of the
  // run. Nothing may be called afterwards.
  virtual bool Finish(int* exit_code) = 0;
};

// All processes of the run, or this one if it was started alone or without MPI
// (MFIR_MPI_ENABLED). Throws UsageError if it was started with others without
// MPI. To be called once, from the thread that calls the others.
std::unique_ptr<ProcessGroup> JoinProcessGroup();

}  // namespace mfir
