// Loops over independent work items on several threads.

#pragma once

#include <sched.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <system_error>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "src/util/cpu_time.h"

namespace mfir {

namespace internal {
inline int num_processes_of_machine = 1;
inline int max_num_threads = -1;
}  // namespace internal

// How many processes of a run share this machine.
inline void ShareMachine(int num_processes) {
  internal::num_processes_of_machine = std::max(1, num_processes);
}

// What the user has chosen (-1: nothing), for loops that nobody tells.
inline void LimitThreads(int num_threads) {
  internal::max_num_threads = num_threads;
}

// Threads for this process: what LimitThreads says, else those of the machine,
// or its share, and no more than the processors that it may use.
inline int NumThreadsOfMachine() {
  if (internal::max_num_threads > 0) return internal::max_num_threads;
  int num = static_cast<int>(std::thread::hardware_concurrency()) /
            internal::num_processes_of_machine;
  cpu_set_t processors;
  if (sched_getaffinity(0, sizeof(processors), &processors) == 0) {
    num = std::min(num, CPU_COUNT(&processors));
  }
  return std::max(1, num);
}

// Calls function(worker, i) for i in [0, count) on `num_threads` threads, each
// with a worker of its own: what make_worker() returns. The calling thread is
// one of them. The others live as long as the loop: OpenMP's would go on
// spinning for work after it, which costs other programs, and other loops of
// ours, their time.
//
// If calls throw, the exception of the lowest i is thrown in the end, so that
// the outcome does not depend on the number of threads.
template <typename MakeWorker, typename Function>
void ParallelForWithWorkers(size_t count,
                            int num_threads,
                            const MakeWorker& make_worker,
                            const Function& function) {
  std::vector<std::exception_ptr> exceptions(count);
  std::atomic<size_t> next = 0;
  const auto run = [&]() {
    const internal::LoopTimer timer(count);
    size_t i = next++;
    if (i >= count) return;
    try {
      auto worker = make_worker();
      for (; i < count; i = next++) {
        try {
          function(worker, i);
        } catch (...) {
          exceptions[i] = std::current_exception();
        }
      }
    } catch (...) {
      exceptions[i] = std::current_exception();
    }
  };
  std::vector<std::thread> threads;
  const size_t num =
      std::min(count, static_cast<size_t>(std::max(1, num_threads)));
  try {
    for (size_t i = 1; i < num; ++i) threads.emplace_back(run);
  } catch (const std::system_error&) {
    // The system gives no more threads: those that there are do the work.
  }
  run();
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& exception : exceptions) {
    if (exception) std::rethrow_exception(exception);
  }
}

namespace internal {
inline thread_local bool is_within_loop = false;
}  // namespace internal

// Calls function(i) for i in [0, count) on `num_threads` threads (-1: all of
// the machine). Within another such loop: on the calling thread.
template <typename Function>
void ParallelFor(size_t count, int num_threads, const Function& function) {
  struct Scope {
    const bool before = internal::is_within_loop;
    Scope() { internal::is_within_loop = true; }
    ~Scope() { internal::is_within_loop = before; }
  };
  if (num_threads <= 0) num_threads = NumThreadsOfMachine();
  if (internal::is_within_loop) num_threads = 1;
  ParallelForWithWorkers(
      count,
      num_threads,
      []() { return 0; },
      [&function](int, size_t i) {
        const Scope scope;
        function(i);
      });
}

// Makes the items make(i) of i in [begin, end) by a ParallelFor, a few at a
// time, and passes them to use(i, item) on the calling thread, in order. What
// make(i) throws is thrown in place of use(i).
template <typename Make, typename Use>
void ParallelInOrder(size_t begin,
                     size_t end,
                     int num_threads,
                     const Make& make,
                     const Use& use) {
  if (num_threads <= 0) num_threads = NumThreadsOfMachine();
  const size_t num_at_once = 2 * static_cast<size_t>(num_threads);
  for (size_t first = begin; first < end; first += num_at_once) {
    const size_t num = std::min(num_at_once, end - first);
    std::vector<std::invoke_result_t<Make, size_t>> items(num);
    std::vector<std::exception_ptr> failures(num);
    ParallelFor(num, num_threads, [&](size_t i) {
      try {
        items[i] = make(first + i);
      } catch (...) {
        failures[i] = std::current_exception();
      }
    });
    for (size_t i = 0; i < num; ++i) {
      if (failures[i]) std::rethrow_exception(failures[i]);
      use(first + i, std::move(items[i]));
    }
  }
}

}  // namespace mfir
