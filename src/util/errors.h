// Errors that end a command, each with the exit code of the contract
// (docs/troubleshooting.md, "Exit codes").

#pragma once

#include <cstring>
#include <new>
#include <stdexcept>
#include <string>

namespace mfir {

enum ExitCode {
  kExitSuccess = 0,
  kExitUsage = 1,
  kExitBadInput = 2,
  kExitSolver = 3,
  kExitOutput = 4,
  kExitOutsideLimits = 5,  // the result is good and written
};

// The message names the option, file, line or field, and says what to do.
class Error : public std::runtime_error {
 public:
  Error(ExitCode exit_code, const std::string& message)
      : std::runtime_error(message), exit_code(exit_code) {}
  const ExitCode exit_code;
};

struct UsageError : Error {
  explicit UsageError(const std::string& message)
      : Error(kExitUsage, message) {}
};

struct InputError : Error {
  explicit InputError(const std::string& message)
      : Error(kExitBadInput, message) {}
};

struct SolverError : Error {
  explicit SolverError(const std::string& message)
      : Error(kExitSolver, message) {}
};

struct OutputError : Error {
  explicit OutputError(const std::string& message)
      : Error(kExitOutput, message) {}
};

// SQLite failed in COLMAP's database, which COLMAP has logged: COLMAP 3.8 ends
// the program, 4 throws this, from destructors, too.
inline bool IsDatabaseFailure(const std::exception& error) {
  return std::strstr(error.what(), "SQLite error") != nullptr;
}

// Of this program, or of SQLite.
inline bool IsOutOfMemory(const std::exception& error) {
  return dynamic_cast<const std::bad_alloc*>(&error) != nullptr ||
         std::strstr(error.what(), "SQLite error: out of memory") != nullptr;
}

// With kExitSolver.
inline constexpr char kOutOfMemory[] =
    "Out of memory. Select fewer frames with --frame_list_path.";

// For both versions, with kExitOutput.
inline constexpr char kColmapCannotGoOn[] =
    "COLMAP cannot go on, the line before says why. Is the disk full?";

}  // namespace mfir
