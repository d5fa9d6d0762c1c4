// SPDX-License-Identifier: Apache-2.0
// The library that base/processes/process_group.cc loads: a ProcessGroup by MPI, and the only user
// of MPI.
#include <sched.h>

#include <cstring>
#include <vector>

#define OMPI_SKIP_MPICXX 1
#define MPICH_SKIP_MPICXX 1
#include <mpi.h>

#include "redrive/base/processes/process_group.h"

namespace redrive {
namespace {

constexpr int kTag = 1;

class MpiProcessGroup final : public ProcessGroup {
 public:
  MpiProcessGroup() {
    int provided = 0;
    MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &provided);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &size_);
    MPI_Comm machine = MPI_COMM_NULL;
    MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &machine);
    MPI_Comm_size(machine, &on_machine_);
    MPI_Comm_rank(machine, &rank_on_machine_);
    cpu_set_t own;
    CPU_ZERO(&own);
    sched_getaffinity(0, sizeof own, &own);
    std::vector<cpu_set_t> all(static_cast<std::size_t>(on_machine_));
    MPI_Allgather(&own, sizeof own, MPI_BYTE, all.data(), sizeof own, MPI_BYTE, machine);
    on_processors_ = 0;
    for (const cpu_set_t& other : all) on_processors_ += CPU_EQUAL(&own, &other) != 0;
    MPI_Comm_free(&machine);
  }
  ~MpiProcessGroup() override { MPI_Finalize(); }

  int rank() const override { return rank_; }
  int size() const override { return size_; }
  int on_machine() const override { return on_machine_; }
  int on_processors() const override { return on_processors_; }
  int rank_on_machine() const override { return rank_on_machine_; }

  void send(int to, const std::string& text) override {
    MPI_Send(text.data(), static_cast<int>(text.size()), MPI_BYTE, to, kTag, MPI_COMM_WORLD);
  }

  std::optional<GroupMessage> receive() override {
    int there = 0, bytes = 0;
    MPI_Status status;
    MPI_Iprobe(MPI_ANY_SOURCE, kTag, MPI_COMM_WORLD, &there, &status);
    if (!there) return std::nullopt;
    MPI_Get_count(&status, MPI_BYTE, &bytes);
    GroupMessage message{status.MPI_SOURCE, std::string(static_cast<std::size_t>(bytes), '\0')};
    MPI_Recv(message.text.data(), bytes, MPI_BYTE, status.MPI_SOURCE, kTag, MPI_COMM_WORLD,
             MPI_STATUS_IGNORE);
    return message;
  }

  void all_gather(std::span<const double> own, std::span<double> all) override {
    const auto n = static_cast<int>(own.size());
    MPI_Allgather(own.data(), n, MPI_DOUBLE, all.data(), n, MPI_DOUBLE, MPI_COMM_WORLD);
  }

  void mean(std::span<float> numbers) override {
    constexpr std::size_t kAtOnce = std::size_t{1} << 22;  // limits the size of the buffer
    for (std::size_t begin = 0; begin < numbers.size(); begin += kAtOnce)
      mean_at_once(numbers.subspan(begin, std::min(kAtOnce, numbers.size() - begin)));
  }

  [[noreturn]] void abort(int code) override {
    MPI_Abort(MPI_COMM_WORLD, code);
    std::_Exit(code);
  }

 private:
  /// Each process sums a part of the numbers, in the order of ranks, and then gets the others'.
  void mean_at_once(std::span<float> numbers) {
    const auto ranks = static_cast<std::size_t>(size_);
    std::vector<int> counts, starts, own_counts, own_starts;
    for (std::size_t r = 0; r < ranks; ++r) {
      starts.push_back(static_cast<int>(numbers.size() * r / ranks));
      counts.push_back(static_cast<int>(numbers.size() * (r + 1) / ranks) - starts.back());
    }
    const int own = counts[static_cast<std::size_t>(rank_)];
    for (int r = 0; r < size_; ++r) {
      own_counts.push_back(own);
      own_starts.push_back(r * own);
    }
    received_.resize(ranks * static_cast<std::size_t>(own));
    MPI_Alltoallv(numbers.data(), counts.data(), starts.data(), MPI_FLOAT, received_.data(),
                  own_counts.data(), own_starts.data(), MPI_FLOAT, MPI_COMM_WORLD);
    float* const sums = numbers.data() + starts[static_cast<std::size_t>(rank_)];
    for (int i = 0; i < own; ++i) {
      float sum = 0;
      for (int r = 0; r < size_; ++r) sum += received_[static_cast<std::size_t>(r * own + i)];
      sums[i] = sum / static_cast<float>(size_);
    }
    MPI_Allgatherv(MPI_IN_PLACE, 0, MPI_DATATYPE_NULL, numbers.data(), counts.data(), starts.data(),
                   MPI_FLOAT, MPI_COMM_WORLD);
  }

  std::vector<float> received_;
  int rank_ = 0, size_ = 1, on_machine_ = 1, on_processors_ = 1, rank_on_machine_ = 0;
};

}  // namespace
}  // namespace redrive

extern "C" redrive::ProcessGroup* redrive_join_mpi() { return new redrive::MpiProcessGroup; }
