// What a command prints, in a file: for jobs that run without a terminal.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/host/options.h"

namespace mfir {

// Where the log is asked for as a file and has a path: until the end of the
// outermost LogFileScope, all that goes to std::cout and std::cerr also goes to
// PATH/COMMAND.DATE-TIME.PID.log, after a line with the command. With the
// target "file" std::cout goes to the file alone: warnings and errors stay on
// stderr. The folder is made where it is missing. A file that has been begun
// goes on. Throws OutputError.
void BeginLogFile(const host::LogOptions& options,
                  const std::string& command,
                  const std::vector<std::string>& arguments);

// A command, which may run others.
class LogFileScope {
 public:
  LogFileScope();
  // The outermost ends the file, with the exit code: its own, or that of the
  // command within it that failed.
  ~LogFileScope();
  LogFileScope(const LogFileScope&) = delete;
  LogFileScope& operator=(const LogFileScope&) = delete;

  void SetExitCode(int exit_code) { exit_code_ = exit_code; }

 private:
  int exit_code_ = 0;
};

}  // namespace mfir
