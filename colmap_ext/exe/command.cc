#include "colmap_ext/exe/command.h"

#include <exception>
#include <filesystem>
#include <iostream>
#include <memory>
#include <new>
#include <string>

#include "src/util/errors.h"
#include "src/util/interruption.h"
#include "src/util/mpi_communicator.h"
#include "src/util/parallel_for.h"

namespace mfir {

namespace {

struct Outcome {
  int exit_code = kExitSuccess;
  std::string message;
};

Outcome RunBody(const std::function<void()>& body) {
  try {
    body();
    return {};
  } catch (const Error& error) {
    WaitIfInterrupted();
    return {error.exit_code, error.what()};
  } catch (const std::bad_alloc&) {
    return {kExitSolver,
            "Out of memory. Select fewer frames with "
            "--frame_list_path."};
  } catch (const std::filesystem::filesystem_error& error) {
    WaitIfInterrupted();
    // Outputs have their own checks: this is a path that the system rejects.
    return {kExitBadInput, std::string(error.what()) + ". Correct the path."};
  } catch (const std::exception& error) {
    WaitIfInterrupted();
    return {kExitSolver, std::string("Unexpected failure: ") + error.what()};
  }
}

int Report(const Outcome& outcome) {
  if (outcome.exit_code != kExitSuccess) {
    std::cerr << "ERROR: " << outcome.message << std::endl;
  }
  return outcome.exit_code;
}

// The group of this process, made once: commands may run one after the other.
ProcessGroup& Group() {
  static const std::unique_ptr<ProcessGroup> group = JoinProcessGroup();
  return *group;
}

}  // namespace

int RunCommand(const std::function<void()>& body) {
  return RunCommandOverRanks([&body](const Communicator& ranks) {
    if (!ranks.IsAlone()) {
      throw UsageError(
          "This command runs as one process: start it without mpirun. "
          "multi_frame_triangulator and multi_frame_intrinsics_refiner can "
          "work as several.");
    }
    body();
  });
}

int RunCommandOverRanks(const std::function<void(const Communicator&)>& body) {
  EndCleanlyAtSignals();
  Outcome outcome;
  ProcessGroup* group = nullptr;
  outcome = RunBody([&group]() { group = &Group(); });
  if (group == nullptr) return Report(outcome);
  ShareMachine(group->NumRanksOfMachine());
  // The others would say the same.
  if (!group->IsFirst()) EndSilentlyAtSignals();
  try {
    outcome = RunBody([&body, group]() { body(*group); });
    if (group->Finish(&outcome.exit_code)) return Report(outcome);
  } catch (const OtherRankFailed& failure) {
    outcome.exit_code = failure.exit_code;
  }
  return outcome.exit_code;
}

}  // namespace mfir
