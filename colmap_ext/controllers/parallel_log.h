// Log lines while COLMAP works on several threads.

#pragma once

#include <iostream>
#include <mutex>
#include <string>

namespace mfir {

// COLMAP reports what it does on std::cout, from all threads at once. Silences
// it as long as this object lives; Print gets through.
class ParallelLog {
 public:
  explicit ParallelLog(bool quiet)
      : quiet_(quiet), stream_(std::cout.rdbuf()), buffer_(std::cout.rdbuf()) {
    std::cout.rdbuf(nullptr);
  }
  ~ParallelLog() {
    std::cout.rdbuf(buffer_);
    std::cout.clear();
  }
  void Print(const std::string& line) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!quiet_) stream_ << line << std::endl;
  }

 private:
  const bool quiet_;
  std::mutex mutex_;
  std::ostream stream_;
  std::streambuf* const buffer_;
};

}  // namespace mfir
