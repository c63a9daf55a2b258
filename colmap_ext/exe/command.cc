#include "colmap_ext/exe/command.h"

#include <cctype>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <memory>
#include <new>
#include <string>

#include "colmap_ext/options/log_file.h"
#include "src/parallel/mpi_communicator.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {

namespace {

// One line without control characters, whatever names are in the message: those
// of files and cameras are the input's.
void PrintError(const std::string& message) {
  std::string line = "ERROR: ";
  for (const char c : message) {
    if (std::iscntrl(static_cast<unsigned char>(c))) {
      char escaped[8];
      std::snprintf(escaped, sizeof(escaped), "\\x%02x", c & 0xff);
      line += escaped;
    } else {
      line += c;
    }
  }
  std::cerr << line << std::endl;
}

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
  } catch (const std::filesystem::filesystem_error& error) {
    WaitIfInterrupted();
    // Outputs have their own checks: this is a path that the system rejects.
    return {kExitBadInput, std::string(error.what()) + ". Correct the path."};
  } catch (const std::exception& error) {
    WaitIfInterrupted();
    if (IsOutOfMemory(error)) return {kExitSolver, kOutOfMemory};
    if (IsDatabaseFailure(error)) return {kExitOutput, kColmapCannotGoOn};
    return {kExitSolver, std::string("Unexpected failure: ") + error.what()};
  }
}

int ReportOutcome(const Outcome& outcome) {
  if (outcome.exit_code != kExitSuccess) PrintError(outcome.message);
  return outcome.exit_code;
}

// The group of this process, made once: commands may run one after the other.
ProcessGroup& Group() {
  static const std::unique_ptr<ProcessGroup> group = JoinProcessGroup();
  return *group;
}

int RunOverRanks(const std::function<void(const Communicator&)>& body) {
  Outcome outcome;
  ProcessGroup* group = nullptr;
  outcome = RunBody([&group]() { group = &Group(); });
  if (group == nullptr) return ReportOutcome(outcome);
  ShareMachine(group->NumRanksOfMachine());
  // The others would say the same.
  if (!group->IsFirst()) EndSilentlyAtSignals();
  try {
    outcome = RunBody([&body, group]() { body(*group); });
    if (group->Finish(&outcome.exit_code)) return ReportOutcome(outcome);
  } catch (const OtherRankFailed& failure) {
    outcome.exit_code = failure.exit_code;
  }
  return outcome.exit_code;
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
  const CleanFailures clean_failures;
  LogFileScope log_file;
  const int exit_code = RunOverRanks(body);
  log_file.SetExitCode(exit_code);
  return exit_code;
}

}  // namespace mfir
