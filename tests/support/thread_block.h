// A block or warp of a GPU as threads of the CPU.

#pragma once

#include <thread>
#include <vector>

#include <pthread.h>

namespace mfir {

// What the threads of a block share.
template <int kSize>
struct Block {
  Block() { pthread_barrier_init(&barrier, nullptr, kSize); }
  ~Block() { pthread_barrier_destroy(&barrier); }
  void Sync() { pthread_barrier_wait(&barrier); }

  pthread_barrier_t barrier;
  float values[kSize];
};

template <int kNumRows, int kNumColumns>
class ThreadGroup {
 public:
  ThreadGroup(Block<kNumRows * kNumColumns>* block, int rank)
      : block_(block), rank_(rank) {}
  int Rank() const { return rank_; }
  static constexpr int Size() { return kNumRows * kNumColumns; }
  int Row() const { return rank_ / kNumColumns; }
  static constexpr int NumRows() { return kNumRows; }
  int Column() const { return rank_ % kNumColumns; }
  static constexpr int NumColumns() { return kNumColumns; }
  void Sync() const { block_->Sync(); }
  // In pairs as by the shuffles of a warp.
  float Sum(float value) const {
    for (int lane = Size() / 2; lane > 0; lane /= 2) {
      block_->values[rank_] = value;
      Sync();
      value += block_->values[rank_ ^ lane];
      Sync();
    }
    return value;
  }

 private:
  Block<kNumRows * kNumColumns>* block_;
  const int rank_;
};

// Calls function(group) on all threads of a block.
template <int kNumRows, int kNumColumns, typename Function>
void RunBlock(const Function& function) {
  Block<kNumRows * kNumColumns> block;
  std::vector<std::thread> threads;
  for (int rank = 0; rank < kNumRows * kNumColumns; ++rank) {
    threads.emplace_back([&block, &function, rank] {
      function(ThreadGroup<kNumRows, kNumColumns>(&block, rank));
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace mfir
