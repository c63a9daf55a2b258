// CPU time of the process, and which part of it more threads can share.

#pragma once

#include <ctime>

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace mfir {

namespace internal {

inline int64_t CpuNanoseconds(clockid_t clock) {
  timespec time = {};
  clock_gettime(clock, &time);
  return static_cast<int64_t>(time.tv_sec) * 1000000000 + time.tv_nsec;
}

inline std::atomic<int64_t> loop_cpu_nanoseconds = 0;
inline thread_local bool is_loop_timed = false;

// Adds the CPU time of its thread, while it lives, to that of loops. Loops
// within loops are part of the outer one, and those of one item are none.
class LoopTimer {
 public:
  explicit LoopTimer(size_t num_items)
      : is_timed_(num_items > 1 && !is_loop_timed) {
    if (!is_timed_) return;
    is_loop_timed = true;
    start_ = CpuNanoseconds(CLOCK_THREAD_CPUTIME_ID);
  }
  ~LoopTimer() {
    if (!is_timed_) return;
    is_loop_timed = false;
    loop_cpu_nanoseconds += CpuNanoseconds(CLOCK_THREAD_CPUTIME_ID) - start_;
  }
  LoopTimer(const LoopTimer&) = delete;
  LoopTimer& operator=(const LoopTimer&) = delete;

 private:
  const bool is_timed_;
  int64_t start_ = 0;
};

}  // namespace internal

struct CpuTime {
  double total_s = 0.0;
  // Outside of the loops of parallel_for.h, whatever the number of threads.
  double serial_s = 0.0;
};

// Of the process so far. To be called outside of such loops.
inline CpuTime ProcessCpuTime() {
  const int64_t total = internal::CpuNanoseconds(CLOCK_PROCESS_CPUTIME_ID);
  return {1e-9 * static_cast<double>(total),
          1e-9 * static_cast<double>(total - internal::loop_cpu_nanoseconds)};
}

}  // namespace mfir
