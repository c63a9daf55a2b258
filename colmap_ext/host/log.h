// COLMAP's log, and our lines beside it.

#pragma once

#include <string>

namespace mfir::host {

// A heading on std::cout, as COLMAP 3.8 has it.
void PrintHeading1(const std::string& heading);

// Once per program, before COLMAP is used.
void InitializeLog(char** argv);

// Silences what COLMAP reports of its work, from all threads, for as long as
// this object lives. COLMAP 3.8 reports on std::cout, 4 through glog: not what
// goes to a file only, or is asked for with --log_level.
class SilentColmap {
 public:
  SilentColmap();
  ~SilentColmap();
  SilentColmap(const SilentColmap&) = delete;
  SilentColmap& operator=(const SilentColmap&) = delete;

  // Where std::cout wrote to before.
  std::streambuf* Stdout() const { return stdout_; }

 private:
  std::streambuf* const stdout_;
  const int min_log_level_;
};

}  // namespace mfir::host
