// CUDA calls that throw GpuError, and the memory and streams that they need.

#pragma once

#include <string>

#include <cuda_runtime.h>

#include "src/dense/cost_map_backend.h"

namespace mfir {

inline void CheckCuda(cudaError_t error, const char* what) {
  if (error == cudaSuccess) return;
  cudaGetLastError();  // not to be reported again by a later call
  throw GpuError(std::string(what) + " failed: " + cudaGetErrorString(error));
}

enum class Memory { kDevice, kPinnedHost };

// An array that only grows.
template <typename T>
class Buffer {
 public:
  explicit Buffer(Memory memory) : memory_(memory) {}
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  ~Buffer() { Free(); }

  void Reserve(size_t size) {
    if (size <= size_) return;
    Free();
    void* data = nullptr;
    if (memory_ == Memory::kDevice) {
      CheckCuda(cudaMalloc(&data, size * sizeof(T)), "Allocating GPU memory");
    } else {
      CheckCuda(cudaMallocHost(&data, size * sizeof(T)),
                "Allocating pinned memory");
    }
    data_ = static_cast<T*>(data);
    size_ = size;
  }

  T* Data() const { return data_; }

 private:
  void Free() {
    // Errors here are those of earlier calls, or of the end of the program.
    if (memory_ == Memory::kDevice) {
      cudaFree(data_);
    } else {
      cudaFreeHost(data_);
    }
    data_ = nullptr;
    size_ = 0;
  }

  const Memory memory_;
  T* data_ = nullptr;
  size_t size_ = 0;
};

template <typename T>
void Copy(T* target,
          const T* source,
          size_t count,
          cudaMemcpyKind kind,
          cudaStream_t stream) {
  CheckCuda(cudaMemcpyAsync(target, source, count * sizeof(T), kind, stream),
            kind == cudaMemcpyHostToDevice ? "Copying to the GPU"
                                           : "Copying from the GPU");
}

class Stream {
 public:
  Stream() { CheckCuda(cudaStreamCreate(&stream_), "Creating a CUDA stream"); }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;
  ~Stream() {
    // Nothing may be in flight when the buffers go.
    cudaStreamSynchronize(stream_);
    cudaStreamDestroy(stream_);
  }

  void Wait() const {
    CheckCuda(cudaStreamSynchronize(stream_), "Computing on the GPU");
  }
  cudaStream_t Get() const { return stream_; }

 private:
  cudaStream_t stream_;
};

// A point in the work of a stream.
class Event {
 public:
  Event() {
    CheckCuda(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming),
              "Creating a CUDA event");
  }
  Event(const Event&) = delete;
  Event& operator=(const Event&) = delete;
  ~Event() { cudaEventDestroy(event_); }

  void Record(cudaStream_t stream) {
    CheckCuda(cudaEventRecord(event_, stream), "Recording a CUDA event");
  }
  // What comes later in the stream begins after the event.
  void Block(cudaStream_t stream) const {
    CheckCuda(cudaStreamWaitEvent(stream, event_, 0),
              "Waiting for a CUDA event");
  }

 private:
  cudaEvent_t event_;
};

}  // namespace mfir
