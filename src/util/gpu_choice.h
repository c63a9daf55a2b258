// Whether work is done on a GPU or on the CPU: what the options ask for, and
// the CPU where a GPU fails.

#pragma once

#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "src/util/errors.h"

namespace mfir {

// No GPU that could be used, or a CUDA call that failed.
struct GpuError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A backend on a GPU, none for the CPU.
template <typename Backend>
class GpuChoice {
 public:
  // `use_gpu` has COLMAP's meaning: 1: on a GPU, a UsageError without one; 0:
  // on the CPU; -1: on a GPU if there is one. `make()` returns the backend or
  // throws GpuError. `fallback`: what the log says before the reason, such as
  // "Cost maps are computed on the CPU".
  template <typename Make>
  GpuChoice(int use_gpu, std::string fallback, const Make& make)
      : use_gpu_(use_gpu), fallback_(std::move(fallback)) {
    if (use_gpu == 0) return;
    try {
      gpu_ = make();
    } catch (const GpuError& error) {
      FallBack(error);
    }
  }

  // Null: the CPU.
  Backend* Get() const { return gpu_.get(); }

  // Calls function(Get()), again with null if the GPU fails. So it may write
  // only what it writes anew then.
  template <typename Function>
  void Call(const Function& function) {
    try {
      function(Get());
    } catch (const GpuError& error) {
      FallBack(error);
      function(Get());
    }
  }

  // Why a GPU is not used: a line for the log, once, else empty.
  std::string TakeFallback() { return std::exchange(message_, ""); }

 private:
  void FallBack(const GpuError& error) {
    if (use_gpu_ == 1) {
      throw UsageError(std::string("use_gpu=1: ") + error.what() +
                       "; use_gpu=-1 takes the CPU then");
    }
    message_ = fallback_ + ": " + error.what();
    gpu_ = nullptr;
  }

  const int use_gpu_;
  const std::string fallback_;
  std::unique_ptr<Backend> gpu_;
  std::string message_;
};

}  // namespace mfir
