#include "src/util/interruption.h"

#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <memory>
#include <new>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

struct State {
  // Held while a result is published, and from a signal to the end.
  std::mutex publication;
  std::mutex paths_mutex;
  std::vector<fs::path> paths;
  std::atomic<bool> interrupted{false};
  std::atomic<bool> running{false};
  std::atomic<bool> given_up{false};
  // For what is done where there is no memory left.
  std::unique_ptr<std::array<char, 1 << 20>> reserve;
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

[[noreturn]] void WaitForEver() {
  while (true) std::this_thread::sleep_for(std::chrono::hours(1));
}

// Both mutexes are held, for good: nothing is published or begun any more.
[[noreturn]] void EndProcess(const std::string& line, int exit_code) {
  State& state = GetState();
  state.interrupted = true;
  for (const fs::path& path : state.paths) RemoveAtOnce(path);
  if (!state.silent) Print(line);
  // Last, and next to the end: threads that still run could make them anew.
  for (const fs::path& path : state.paths) {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  _exit(exit_code);
}

[[noreturn]] void WaitForSignal(const sigset_t& signals) {
  int signal = 0;
  while (sigwait(&signals, &signal) != 0) {
  }
  State& state = GetState();
  state.publication.lock();
  state.paths_mutex.lock();
  EndProcess(std::string("Interrupted by ") +
                 (signal == SIGINT ? "SIGINT" : "SIGTERM") +
                 ": results that were complete are kept, the unfinished one "
                 "is removed.\n",
             128 + signal);
}

// The same from a thread that may hold the mutexes itself, or have no memory.
[[noreturn]] void GiveUp(const char* message, int exit_code) {
  State& state = GetState();
  if (state.given_up.exchange(true)) WaitForEver();
  state.reserve.reset();
  for (int i = 0; i < 100; ++i) {
    if (std::try_lock(state.publication, state.paths_mutex) < 0) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EndProcess(std::string("ERROR: ") + message + "\n", exit_code);
}

[[noreturn]] void EndAtUncaughtException() {
  try {
    const std::exception_ptr exception = std::current_exception();
    if (exception) std::rethrow_exception(exception);
  } catch (const std::system_error& error) {
    if (error.code() == std::errc::resource_unavailable_try_again) {
      GiveUp(kOutOfMemory, kExitSolver);
    }
  } catch (const std::exception& error) {
    if (IsOutOfMemory(error)) GiveUp(kOutOfMemory, kExitSolver);
    if (IsDatabaseFailure(error)) GiveUp(kColmapCannotGoOn, kExitOutput);
  } catch (...) {
  }
  GiveUp("Unexpected failure in a library.", kExitSolver);
}

// COLMAP 3.8 does not tell us why it ends the program.
bool HasMemory() {
  constexpr size_t kSize = size_t{16} << 20;
  void* memory = mmap(nullptr,
                      kSize,
                      PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS,
                      -1,
                      0);
  return memory != MAP_FAILED && munmap(memory, kSize) == 0;
}

// Without temporary paths nothing is being written: it is a call of --help,
// say.
void EndAtExit(int status, void*) {
  const State& state = GetState();
  if (!state.running || status == 0 || state.paths.empty()) return;
  if (!HasMemory()) GiveUp(kOutOfMemory, kExitSolver);
  GiveUp(kColmapCannotGoOn, kExitOutput);
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
    sigset_t before;
    pthread_sigmask(SIG_BLOCK, &signals, &before);
    try {
      std::thread([signals] { WaitForSignal(signals); }).detach();
    } catch (const std::system_error&) {
      // The system gives no more threads: the signals do what they always do.
      pthread_sigmask(SIG_SETMASK, &before, nullptr);
    }
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

CleanFailures::CleanFailures() {
  static const bool installed = [] {
    on_exit(&EndAtExit, nullptr);
    std::set_terminate(&EndAtUncaughtException);
    return true;
  }();
  static_cast<void>(installed);
  GetState().reserve = std::make_unique<std::array<char, 1 << 20>>();
  GetState().running = true;
}

CleanFailures::~CleanFailures() { GetState().running = false; }

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
