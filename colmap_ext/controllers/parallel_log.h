// Log lines while COLMAP works on several threads.

#pragma once

#include <mutex>
#include <ostream>
#include <string>

#include "colmap_ext/host/log.h"

namespace mfir {

// Silences COLMAP as long as this object lives; Print gets through.
class ParallelLog {
 public:
  explicit ParallelLog(bool quiet) : quiet_(quiet), stream_(silent_.Stdout()) {}

  void Print(const std::string& line) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!quiet_) stream_ << line << std::endl;
  }

 private:
  const bool quiet_;
  std::mutex mutex_;
  const host::SilentColmap silent_;
  std::ostream stream_;
};

}  // namespace mfir
