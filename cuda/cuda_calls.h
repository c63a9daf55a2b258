// CUDA calls, checked: they throw GpuError. For files that nvcc compiles.

#pragma once

#include <cstddef>
#include <string>

#include <cuda_runtime.h>

#include "src/util/gpu_choice.h"

namespace mfir {

inline void Check(cudaError_t error, const char* what) {
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
      Check(cudaMalloc(&data, size * sizeof(T)), "Allocating GPU memory");
    } else {
      Check(cudaMallocHost(&data, size * sizeof(T)),
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
  Check(cudaMemcpyAsync(target, source, count * sizeof(T), kind, stream),
        kind == cudaMemcpyHostToDevice ? "Copying to the GPU"
                                       : "Copying from the GPU");
}

class Stream {
 public:
  Stream() { Check(cudaStreamCreate(&stream_), "Creating a CUDA stream"); }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;
  ~Stream() {
    // Nothing may be in flight when the buffers go.
    cudaStreamSynchronize(stream_);
    cudaStreamDestroy(stream_);
  }

  void Wait() const {
    Check(cudaStreamSynchronize(stream_), "Computing on the GPU");
  }
  cudaStream_t Get() const { return stream_; }

 private:
  cudaStream_t stream_;
};

// A point in the work of a stream.
class Event {
 public:
  Event() {
    Check(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming),
          "Creating a CUDA event");
  }
  Event(const Event&) = delete;
  Event& operator=(const Event&) = delete;
  ~Event() { cudaEventDestroy(event_); }

  void Record(cudaStream_t stream) {
    Check(cudaEventRecord(event_, stream), "Recording a CUDA event");
  }
  // What comes later in the stream begins after the event.
  void Block(cudaStream_t stream) const {
    Check(cudaStreamWaitEvent(stream, event_, 0), "Waiting for a CUDA event");
  }

 private:
  cudaEvent_t event_;
};

// Index of the GPU to use, and its name.
inline int ChooseGpu(int gpu_index, std::string* name) {
  int num_gpus = 0;
  const cudaError_t error = cudaGetDeviceCount(&num_gpus);
  if (error == cudaErrorInsufficientDriver || error == cudaErrorNoDevice ||
      (error == cudaSuccess && num_gpus == 0)) {
    cudaGetLastError();
    throw GpuError("there is no GPU, or its driver is older than CUDA " +
                   std::to_string(CUDART_VERSION / 1000));
  }
  Check(error, "Looking for a GPU");
  if (gpu_index >= num_gpus) {
    throw GpuError("gpu_index " + std::to_string(gpu_index) + ": there are " +
                   std::to_string(num_gpus) + " GPUs");
  }
  int max_num_multiprocessors = 0;
  int chosen = gpu_index;
  for (int i = 0; i < num_gpus; ++i) {
    if (gpu_index >= 0 && i != gpu_index) continue;
    cudaDeviceProp properties;
    Check(cudaGetDeviceProperties(&properties, i), "Querying the GPU");
    if (properties.multiProcessorCount <= max_num_multiprocessors) continue;
    max_num_multiprocessors = properties.multiProcessorCount;
    chosen = i;
    *name = "GPU " + std::to_string(i) + " (" + properties.name + ")";
  }
  return chosen;
}

}  // namespace mfir
