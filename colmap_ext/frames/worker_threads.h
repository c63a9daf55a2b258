// Loops over independent work items with an object per thread.

#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <thread>
#include <vector>

namespace mfir {

// Calls function(worker, i) for i in [0, count) on `num_threads` threads, each
// with a worker of its own: what make_worker() returns. Threads of their own,
// not OpenMP's: frames are processed in an OpenMP loop, and one within another
// would have a single thread. If calls throw, the exception of the lowest i is
// thrown in the end, so that the outcome does not depend on the number of
// threads.
template <typename MakeWorker, typename Function>
void ForEachWithWorkers(size_t count,
                        int num_threads,
                        const MakeWorker& make_worker,
                        const Function& function) {
  std::vector<std::exception_ptr> exceptions(count);
  std::atomic<size_t> next = 0;
  const auto run = [&]() {
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
  const size_t num = std::min(count, static_cast<size_t>(num_threads));
  for (size_t i = 0; i < num; ++i) threads.emplace_back(run);
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& exception : exceptions) {
    if (exception) std::rethrow_exception(exception);
  }
}

}  // namespace mfir
