#include "src/parallel/mpi_communicator.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include "src/util/errors.h"

#ifdef MFIR_MPI_ENABLED
#include <mpi.h>
#endif

namespace mfir {
namespace {

class AloneGroup final : public OnlyProcess<ProcessGroup> {
 public:
  int NumRanksOfMachine() const override { return 1; }
  bool Finish(int*) override { return true; }
};

// As Open MPI, MPICH and their relatives in Slurm say it; 1 if none does.
int NumStartedTogether() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"}) {
    const char* value = std::getenv(name);
    if (value != nullptr) return std::max(1, std::atoi(value));
  }
  return 1;
}

#ifdef MFIR_MPI_ENABLED

// Of one message: MPI counts in int.
constexpr size_t kMaxBytes = size_t{1} << 30;

// Every call first agrees that no rank has failed, so that none waits for one
// that will not come.
class MpiGroup final : public ProcessGroup {
 public:
  MpiGroup() {
    int level = 0;
    MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &level);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &num_ranks_);
    if (num_ranks_ < NumStartedTogether()) {
      MPI_Finalize();
      throw UsageError(
          "The processes do not find each other: start them with the mpirun of "
          "the MPI that this program was built with.");
    }
    MPI_Comm machine;
    MPI_Comm_split_type(
        MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, rank_, MPI_INFO_NULL, &machine);
    MPI_Comm_size(machine, &num_ranks_of_machine_);
    MPI_Comm_free(&machine);
  }
  ~MpiGroup() override { MPI_Finalize(); }

  int Rank() const override { return rank_; }
  int NumRanks() const override { return num_ranks_; }
  int NumRanksOfMachine() const override { return num_ranks_of_machine_; }

  // To the first rank and back: one order of the sum, one result.
  void Sum(double* values, size_t count) const override {
    AgreeToGoOn();
    ForEachPart(count, sizeof(double), [&](size_t begin, int num) {
      double* part = values + begin;
      MPI_Request request;
      MPI_Ireduce(rank_ == 0 ? MPI_IN_PLACE : part,
                  part,
                  num,
                  MPI_DOUBLE,
                  MPI_SUM,
                  0,
                  MPI_COMM_WORLD,
                  &request);
      Wait(&request);
      MPI_Ibcast(part, num, MPI_DOUBLE, 0, MPI_COMM_WORLD, &request);
      Wait(&request);
    });
  }

  std::vector<std::string> Gather(const std::string& bytes) const override {
    std::vector<double> sizes(num_ranks_, 0.0);
    sizes[rank_] = static_cast<double>(bytes.size());
    Sum(sizes.data(), sizes.size());
    MPI_Request request;
    if (rank_ != 0) {
      ForEachPart(bytes.size(), 1, [&](size_t begin, int num) {
        MPI_Isend(bytes.data() + begin,
                  num,
                  MPI_CHAR,
                  0,
                  0,
                  MPI_COMM_WORLD,
                  &request);
        Wait(&request);
      });
      return {};
    }
    std::vector<std::string> all = {bytes};
    for (int rank = 1; rank < num_ranks_; ++rank) {
      std::string& received =
          all.emplace_back(static_cast<size_t>(sizes[rank]), '\0');
      ForEachPart(received.size(), 1, [&](size_t begin, int num) {
        MPI_Irecv(
            &received[begin], num, MPI_CHAR, rank, 0, MPI_COMM_WORLD, &request);
        Wait(&request);
      });
    }
    return all;
  }

  void Broadcast(std::string* bytes) const override {
    double size = rank_ == 0 ? static_cast<double>(bytes->size()) : 0.0;
    Sum(&size, 1);
    bytes->resize(static_cast<size_t>(size));
    ForEachPart(bytes->size(), 1, [&](size_t begin, int num) {
      MPI_Request request;
      MPI_Ibcast(&(*bytes)[begin], num, MPI_CHAR, 0, MPI_COMM_WORLD, &request);
      Wait(&request);
    });
  }

  bool Finish(int* exit_code) override {
    const Outcome outcome = Agree(*exit_code);
    *exit_code = outcome.exit_code;
    return outcome.exit_code == 0 || outcome.rank == rank_;
  }

 private:
  // The highest exit code and the first rank that has it; MPI_2INT.
  struct Outcome {
    int exit_code;
    int rank;
  };

  template <typename Function>
  static void ForEachPart(size_t count, size_t size, const Function& function) {
    const size_t max_count = kMaxBytes / size;
    for (size_t begin = 0; begin < count; begin += max_count) {
      function(begin, static_cast<int>(std::min(count - begin, max_count)));
    }
  }

  // Leaves the processor to others: MPI's own waits would spin.
  static void Wait(MPI_Request* request) {
    constexpr int kNumQuickTests = 1000;
    int done = 0;
    for (int i = 0;; ++i) {
      MPI_Test(request, &done, MPI_STATUS_IGNORE);
      if (done != 0) return;
      if (i < kNumQuickTests) {
        std::this_thread::yield();
      } else {
        std::this_thread::sleep_for(std::chrono::microseconds(200));
      }
    }
  }

  Outcome Agree(int exit_code) const {
    const Outcome mine = {exit_code, rank_};
    Outcome common = mine;
    MPI_Request request;
    MPI_Iallreduce(
        &mine, &common, 1, MPI_2INT, MPI_MAXLOC, MPI_COMM_WORLD, &request);
    Wait(&request);
    return common;
  }

  void AgreeToGoOn() const {
    const Outcome outcome = Agree(0);
    if (outcome.exit_code != 0) throw OtherRankFailed{outcome.exit_code};
  }

  int rank_ = 0;
  int num_ranks_ = 1;
  int num_ranks_of_machine_ = 1;
};

#endif

}  // namespace

std::unique_ptr<ProcessGroup> JoinProcessGroup() {
#ifdef MFIR_MPI_ENABLED
  // What srun starts with PMIx says its rank only.
  const bool is_started = NumStartedTogether() > 1 ||
                          std::getenv("OMPI_COMM_WORLD_SIZE") != nullptr ||
                          std::getenv("PMIX_RANK") != nullptr;
  if (is_started) return std::make_unique<MpiGroup>();
#else
  if (NumStartedTogether() > 1) {
    throw UsageError(
        "This program was built without MPI and cannot work on one capture "
        "with others: start it alone, or build with -DMFIR_MPI_ENABLED=ON.");
  }
#endif
  return std::make_unique<AloneGroup>();
}

}  // namespace mfir
