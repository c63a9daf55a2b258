// Ranks that are threads of the test, in the stead of processes.

#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "src/parallel/communicator.h"

namespace mfir {

// What the threads share.
struct ThreadRanksState {
  explicit ThreadRanksState(int num_ranks) : num_ranks(num_ranks) {}

  // Returns what all ranks have brought, once all have come.
  std::vector<std::string> Exchange(int rank, const std::string& bytes) {
    std::unique_lock<std::mutex> lock(mutex);
    // The last round has to be over.
    arrived.wait(lock, [this] { return num_leaving == 0; });
    brought.resize(num_ranks);
    brought[rank] = bytes;
    if (++num_here == num_ranks) {
      num_leaving = num_ranks;
      arrived.notify_all();
    }
    arrived.wait(lock, [this] { return num_leaving > 0; });
    const std::vector<std::string> all = brought;
    --num_here;
    if (--num_leaving == 0) arrived.notify_all();
    return all;
  }

  const int num_ranks;
  std::mutex mutex;
  std::condition_variable arrived;
  std::vector<std::string> brought;
  int num_here = 0;
  int num_leaving = 0;
};

class ThreadRank final : public Communicator {
 public:
  ThreadRank(int rank, ThreadRanksState* state) : rank_(rank), state_(state) {}

  int Rank() const override { return rank_; }
  int NumRanks() const override { return state_->num_ranks; }
  void Sum(double* values, size_t count) const override {
    const std::vector<std::string> all =
        state_->Exchange(rank_,
                         std::string(reinterpret_cast<const char*>(values),
                                     count * sizeof(double)));
    for (size_t i = 0; i < count; ++i) {
      values[i] = 0.0;
      for (const std::string& bytes : all) {
        values[i] += reinterpret_cast<const double*>(bytes.data())[i];
      }
    }
  }
  std::vector<std::string> Gather(const std::string& bytes) const override {
    const std::vector<std::string> all = state_->Exchange(rank_, bytes);
    return rank_ == 0 ? all : std::vector<std::string>();
  }
  void Broadcast(std::string* bytes) const override {
    *bytes = state_->Exchange(rank_, rank_ == 0 ? *bytes : "")[0];
  }

 private:
  const int rank_;
  ThreadRanksState* const state_;
};

// Calls function(ranks) on a thread for each rank.
inline void RunRanks(int num_ranks,
                     const std::function<void(const Communicator&)>& function) {
  ThreadRanksState state(num_ranks);
  std::vector<std::thread> threads;
  for (int rank = 0; rank < num_ranks; ++rank) {
    threads.emplace_back([&function, &state, rank] {
      const ThreadRank ranks(rank, &state);
      function(ranks);
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace mfir
