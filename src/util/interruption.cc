#include "src/util/interruption.h"

#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <fstream>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace mfir {
namespace {

namespace fs = std::filesystem;

struct State {
  // Held while a result is published, and from a signal to the end.
  std::mutex publication;
  std::mutex paths_mutex;
  std::vector<fs::path> paths;
  std::atomic<bool> interrupted{false};
  std::atomic<bool> silent{false};
};

// Never destroyed: the signal thread outlives main.
State& GetState() {
  static State* state = new State;
  return *state;
}

// Moved away before it is removed, and replaced by a file that is no folder:
// what threads that still run write there fails.
void RemoveAtOnce(const fs::path& path) {
  std::error_code ignored;
  fs::path doomed = path;
  doomed += ".removed_" + std::to_string(getpid());
  fs::rename(path, doomed, ignored);
  std::ofstream(path).flush();
  fs::remove_all(doomed, ignored);
}

void Print(const std::string& line) {
  const ssize_t ignored = write(STDERR_FILENO, line.data(), line.size());
  static_cast<void>(ignored);
}

[[noreturn]] void WaitForSignal(const sigset_t& signals) {
  int signal = 0;
  while (sigwait(&signals, &signal) != 0) {
  }
  State& state = GetState();
  // Both for good: nothing is published or begun any more.
  state.publication.lock();
  state.paths_mutex.lock();
  state.interrupted = true;
  for (const fs::path& path : state.paths) RemoveAtOnce(path);
  for (const fs::path& path : state.paths) {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  if (state.silent) _exit(128 + signal);
  Print(std::string("Interrupted by ") +
        (signal == SIGINT ? "SIGINT" : "SIGTERM") +
        ": results that were complete are kept, the unfinished one is "
        "removed.\n");
  _exit(128 + signal);
}

}  // namespace

// A thread of its own waits for the signals, for a handler could neither lock
// nor remove files.
void EndCleanlyAtSignals() {
  static const bool started = [] {
    GetState();
    sigset_t signals;
    sigemptyset(&signals);
    for (const int signal : {SIGINT, SIGTERM}) {
      // A program started in the background by a script ignores SIGINT.
      struct sigaction action = {};
      sigaction(signal, nullptr, &action);
      if (action.sa_handler != SIG_IGN) sigaddset(&signals, signal);
    }
    // Threads that start later inherit this.
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    std::thread([signals] { WaitForSignal(signals); }).detach();
    return true;
  }();
  static_cast<void>(started);
}

void EndSilentlyAtSignals() { GetState().silent = true; }

void WaitIfInterrupted() {
  while (GetState().interrupted) {
    std::this_thread::sleep_for(std::chrono::seconds(1));
  }
}

ScopedTemporaryPath::ScopedTemporaryPath(fs::path path)
    : path_(std::move(path)) {
  const std::lock_guard<std::mutex> lock(GetState().paths_mutex);
  GetState().paths.push_back(path_);
}

ScopedTemporaryPath::~ScopedTemporaryPath() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
  const std::lock_guard<std::mutex> lock(GetState().paths_mutex);
  std::vector<fs::path>& paths = GetState().paths;
  paths.erase(std::find(paths.begin(), paths.end(), path_));
}

SignalDelay::SignalDelay() : lock_(GetState().publication) {}

}  // namespace mfir
