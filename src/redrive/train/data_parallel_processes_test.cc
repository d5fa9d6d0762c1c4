// SPDX-License-Identifier: Apache-2.0
// Data-parallel steps of several processes, which are threads here.
#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <filesystem>
#include <functional>
#include <mutex>
#include <stdexcept>
#include <thread>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/train/data_parallel_testing.h"

namespace redrive {
namespace {

/// Where processes, threads here, wait for each other.
class Meeting {
 public:
  explicit Meeting(int n) : doubles(static_cast<std::size_t>(n)), floats(doubles.size()) {}

  /// Returns when all have arrived. Throws std::runtime_error once one has failed.
  void arrive() {
    std::unique_lock lock(mutex_);
    const std::size_t round = rounds_;
    if (++here_ == doubles.size()) {
      here_ = 0;
      ++rounds_;
      changed_.notify_all();
    }
    changed_.wait(lock, [&] { return rounds_ != round || failed_; });
    if (rounds_ == round) throw std::runtime_error("another process failed");
  }
  void fail() {
    const std::scoped_lock lock(mutex_);
    failed_ = true;
    changed_.notify_all();
  }

  std::vector<std::span<const double>> doubles;
  std::vector<std::span<float>> floats;

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::size_t here_ = 0, rounds_ = 0;
  bool failed_ = false;
};

class ThreadGroup final : public ProcessGroup {
 public:
  ThreadGroup(Meeting* meeting, int rank) : meeting_(*meeting), rank_(rank) {}
  int rank() const override { return rank_; }
  int size() const override { return static_cast<int>(meeting_.floats.size()); }
  void all_gather(std::span<const double> own, std::span<double> all) override {
    meeting_.doubles[rank_] = own;
    meeting_.arrive();
    for (std::size_t r = 0; r < meeting_.doubles.size(); ++r)
      std::ranges::copy(meeting_.doubles[r], all.begin() + std::ssize(own) * std::ptrdiff_t(r));
    meeting_.arrive();
  }
  void mean(std::span<float> numbers) override {
    meeting_.floats[rank_] = numbers;
    meeting_.arrive();
    std::vector<float> means(numbers.size());
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      for (const std::span<float> part : meeting_.floats) means[i] += part[i];
      means[i] /= static_cast<float>(size());
    }
    meeting_.arrive();
    std::ranges::copy(means, numbers.begin());
    meeting_.arrive();
  }

 private:
  Meeting& meeting_;
  int rank_;
};

/// Runs work(rank, group) of each process. Throws the first error, once all have ended.
void run_processes(int n, const std::function<void(int, ProcessGroup&)>& work) {
  Meeting meeting(n);
  std::mutex mutex;
  std::exception_ptr first;
  std::vector<std::thread> threads;
  for (int rank = 0; rank < n; ++rank)
    threads.emplace_back([&, rank] {
      ThreadGroup group(&meeting, rank);
      try {
        work(rank, group);
      } catch (...) {
        const std::scoped_lock lock(mutex);
        if (!first) first = std::current_exception();
        meeting.fail();
      }
    });
  for (std::thread& thread : threads) thread.join();
  if (first) std::rethrow_exception(first);
}

TEST(RunProcesses, AFailureEndsTheOthers) {
  EXPECT_THROW(run_processes(3,
                             [](int rank, ProcessGroup& group) {
                               if (rank == 1) throw IoError("disk", "full");
                               std::vector<float> numbers(2);
                               group.mean(numbers);
                             }),
               IoError);
}

TEST_F(DataParallelTest, ProcessesComputeTheStepsOfBackendsOfOneProcess) {
  constexpr int kRanks = 3, kSteps = 4;
  GroupRun one = group_run("one", false);
  one.draw(16);
  const std::string before = checkpoint_bytes(one.run.state);
  std::vector<std::unique_ptr<kernels::Backend>> owned;
  std::vector<kernels::Backend*> backends;
  for (int rank = 0; rank < kRanks; ++rank)
    backends.push_back(owned.emplace_back(processor_backend(1)).get());
  HostMean mean(backends);
  DataParallelGroup group(backends, &mean, &one.run.state);
  group.begin();
  std::vector<StepResult> expected;
  for (int step = 0; step < kSteps; ++step)
    expected.push_back(group.step(one.set(), one.next(), 1e-2));

  std::deque<GroupRun> runs;  // which refer to themselves
  for (int rank = 0; rank < kRanks; ++rank)
    runs.emplace_back(tiny_run(folder_.path / ("process " + std::to_string(rank)), folder_.path,
                               tiny_options(1)));
  run_processes(kRanks, [&](int rank, ProcessGroup& processes) {
    GroupRun& of = runs[static_cast<std::size_t>(rank)];
    of.run.state = parse_checkpoint(before, "");
    DataParallelGroup own({backends[static_cast<std::size_t>(rank)]}, nullptr, &of.run.state,
                          &processes);
    EXPECT_EQ(own.size(), kRanks);
    own.begin();
    for (int step = 0; step < kSteps; ++step) {
      const StepResult result = own.step(of.set(), of.next(), 1e-2);
      const StepResult& other = expected[static_cast<std::size_t>(step)];
      EXPECT_EQ(result.pixels, other.pixels);
      EXPECT_EQ(result.loss, other.loss);
      EXPECT_EQ(result.rgb_mse, other.rgb_mse);
      EXPECT_EQ(loss_of(result, "colour"), loss_of(other, "colour"));
      EXPECT_EQ(result.views.size(), other.views.size());
      for (std::size_t v = 0; v < std::min(result.views.size(), other.views.size()); ++v)
        EXPECT_EQ(result.views[v].d_rotation, other.views[v].d_rotation);
    }
    EXPECT_TRUE(same_weights(of.run.state, one.run.state)) << rank;
  });
}

TEST_F(DataParallelTest, ARunOfProcessesIsWrittenByTheFirst) {
  constexpr int kRanks = 2;
  TrainOptions options = tiny_options(60);
  options.max_steps = 60;
  std::vector<redrive::Run> runs;
  for (const char* name : {"first", "second"})
    runs.push_back(tiny_run(folder_.path / name, folder_.path, options));
  run_processes(kRanks, [&](int rank, ProcessGroup& processes) {
    redrive::Run& run = runs[static_cast<std::size_t>(rank)];
    ThreadPool pool(1);
    const auto backend = processor_backend(1);
    const TrainingData data = load_training_data(run, pool);
    EXPECT_EQ(train(&run, data, {backend.get()}, nullptr, never_, nullptr, &processes),
              TrainEnd::kFinished);
  });
  EXPECT_TRUE(same_weights(runs[0].state, runs[1].state));
  EXPECT_EQ(runs[0].state.seconds, runs[1].state.seconds) << "one clock";
  EXPECT_EQ(load_checkpoint(runs[0].paths.checkpoint()).step, 60);
  EXPECT_EQ(read_metrics(runs[0].paths).size(), 3u);
  EXPECT_FALSE(std::filesystem::exists(runs[1].paths.checkpoint()));
  EXPECT_FALSE(std::filesystem::exists(runs[1].paths.metrics()));
}

TEST_F(DataParallelTest, ProcessesMustBeginAlike) {
  const std::vector<std::function<void(redrive::Run&)>> changes{
      [](redrive::Run& run) { run.state.model->parameters[3] += 1; },
      [](redrive::Run& run) { run.state.adam.first_moment[3] += 1; },
      [](redrive::Run& run) { run.state.adam.second_moment[3] += 1; },
      [](redrive::Run& run) { ++run.state.seed; },
      [](redrive::Run& run) { run.options.max_steps += 20; },
      [](redrive::Run& run) { run.options.threads += 1; },  // may differ
  };
  TrainOptions options = tiny_options(60);
  options.max_steps = 3;
  for (std::size_t k = 0; k < changes.size(); ++k) {
    std::vector<redrive::Run> runs;
    for (const char* name : {"first", "second"})
      runs.push_back(tiny_run(folder_.path / (name + std::to_string(k)), folder_.path, options));
    changes[k](runs[1]);
    const auto train_both = [&] {
      run_processes(2, [&](int rank, ProcessGroup& processes) {
        redrive::Run& run = runs[static_cast<std::size_t>(rank)];
        run.state.step = 1;  // or nerf would begin anew
        ThreadPool pool(1);
        const auto backend = processor_backend(1);
        const TrainingData data = load_training_data(run, pool);
        train(&run, data, {backend.get()}, nullptr, never_, nullptr, &processes);
      });
    };
    if (k + 1 == changes.size())
      EXPECT_NO_THROW(train_both());
    else
      EXPECT_THROW(train_both(), UsageError) << k;
  }
}

}  // namespace
}  // namespace redrive
