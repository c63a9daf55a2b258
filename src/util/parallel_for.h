// Loops over independent work items on several threads.

#pragma once

#include <omp.h>

#include <cstddef>
#include <exception>
#include <vector>

namespace mfir {

// Calls function(i) for i in [0, count) on `num_threads` threads (-1: all). If
// calls throw, the exception of the lowest i is thrown after the loop, so that
// the outcome does not depend on the number of threads.
template <typename Function>
void ParallelFor(size_t count, int num_threads, const Function& function) {
  std::vector<std::exception_ptr> exceptions(count);
  const int effective_num_threads =
      num_threads > 0 ? num_threads : omp_get_max_threads();
#pragma omp parallel for schedule(dynamic) num_threads(effective_num_threads)
  for (size_t i = 0; i < count; ++i) {
    try {
      function(i);
    } catch (...) {
      exceptions[i] = std::current_exception();
    }
  }
  for (const std::exception_ptr& exception : exceptions) {
    if (exception) {
      std::rethrow_exception(exception);
    }
  }
}

}  // namespace mfir
