// Ctrl-C, SIGTERM and libraries that give up: the process ends at once, but
// leaves nothing behind that is half done.

#pragma once

#include <filesystem>
#include <mutex>
#include <string>

namespace mfir {

// From now on SIGINT and SIGTERM remove all temporary paths, print one line to
// stderr and end the process with exit code 130 or 143, as shells expect. To be
// called before other threads start; calling it again does nothing.
void EndCleanlyAtSignals();

// From now on without the line: another process prints it.
void EndSilentlyAtSignals();

// Does not return if such a signal has come: what fails now fails because of
// it.
void WaitIfInterrupted();

// While one lives, what libraries end the process with does so as a signal: an
// exception that nobody catches (of one of their threads) with exit code 3, a
// call of exit with exit code 4, since they are COLMAP's for databases that
// cannot be written. One at a time.
class CleanFailures {
 public:
  CleanFailures();
  ~CleanFailures();
  CleanFailures(const CleanFailures&) = delete;
  CleanFailures& operator=(const CleanFailures&) = delete;
};

// A file or folder, with what is in it, that goes when the object goes or when
// a signal ends the process.
class ScopedTemporaryPath {
 public:
  explicit ScopedTemporaryPath(std::filesystem::path path);
  ~ScopedTemporaryPath();
  ScopedTemporaryPath(const ScopedTemporaryPath&) = delete;
  ScopedTemporaryPath& operator=(const ScopedTemporaryPath&) = delete;

  const std::filesystem::path& Path() const { return path_; }

 private:
  const std::filesystem::path path_;
};

// While one lives signals wait: for the renames that publish a result, which
// belong together.
class SignalDelay {
 public:
  SignalDelay();

 private:
  std::unique_lock<std::mutex> lock_;
};

}  // namespace mfir
