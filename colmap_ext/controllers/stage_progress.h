// Lines on how far the stage of a frame has come.

#pragma once

#include <chrono>
#include <memory>
#include <mutex>
#include <string>

#include "colmap_ext/controllers/parallel_log.h"
#include "src/util/progress.h"

namespace mfir {

// Prints a line such as "Frame '12': 10 / 40 images, 30 s left", the first
// after `interval`, and no more often. The time starts with this call, and
// `log` must outlive what it returns.
inline ProgressFunction LogProgress(
    const std::string& frame_name,
    const std::string& things,
    ParallelLog* log,
    std::chrono::duration<double> interval = std::chrono::seconds(5)) {
  using Clock = std::chrono::steady_clock;
  struct State {
    std::mutex mutex;
    const Clock::time_point start = Clock::now();
    Clock::time_point last_line = start;
  };
  return
      [=, state = std::make_shared<State>()](size_t num_done, size_t num_all) {
        const std::lock_guard<std::mutex> lock(state->mutex);
        const Clock::time_point now = Clock::now();
        if (num_done == 0 || num_done >= num_all ||
            now - state->last_line < interval) {
          return;
        }
        state->last_line = now;
        const double seconds_per_thing =
            std::chrono::duration<double>(now - state->start).count() /
            static_cast<double>(num_done);
        const auto seconds_left = static_cast<long>(
            seconds_per_thing * static_cast<double>(num_all - num_done) + 1.0);
        log->Print("Frame '" + frame_name + "': " + std::to_string(num_done) +
                   " / " + std::to_string(num_all) + " " + things + ", " +
                   std::to_string(seconds_left) + " s left");
      };
}

}  // namespace mfir
