// SPDX-License-Identifier: Apache-2.0
// For tests of data-parallel steps: processes, which are threads here, and runs that draw small
// batches.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/methods/grid/tiny_grid_model_testing.h"
#include "redrive/train/distributed/data_parallel.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {

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
inline void run_processes(int n, const std::function<void(int, ProcessGroup&)>& work) {
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

/// A run and its training set.
struct GroupRun {
  redrive::Run run;
  TrainingData data;
  PixelSampler sampler;
  LidarReturns returns;
  std::unique_ptr<LidarSampler> lidar;

  explicit GroupRun(redrive::Run from)
      : run(std::move(from)),
        data([this] {
          ThreadPool pool(1);
          return load_training_data(run, pool);
        }()),
        sampler(run.scene, data.images, 1) {}
  TrainingSet set() const { return {run.scene, data.images, returns, sampler, lidar.get()}; }
  /// Rays that each rank draws.
  void draw(int rays) {
    auto& model = dynamic_cast<RayModel&>(*run.state.model);
    model.batch_rays = rays;
    model.error_rays = 0;
    if (auto* grid = dynamic_cast<GridModel*>(&model)) grid->max_batch_factor = 1;
  }
  /// Adds LiDAR rays to each rank's batch, of returns 3 m ahead.
  void draw_lidar(int rays) {
    returns.n = 100;
    returns.direction.assign(300, 0);
    std::fill_n(returns.direction.begin(), 100, 1.0f);
    returns.range_m.assign(100, 3.0f);
    returns.t_ns.assign(100, 0);
    lidar = std::make_unique<LidarSampler>(returns, run.scene, 1);
    dynamic_cast<RayModel&>(*run.state.model).lidar_rays = rays;
  }
  StepRequest next() const {
    StepRequest request = next_step(run.state);
    request.pose_gradients = true;
    return request;
  }
};

class DataParallelTest : public TrainingTest {
 protected:
  redrive::Run fresh_run(const std::string& name, bool grid, int max_steps = 1) {
    TrainOptions options = tiny_options(max_steps);
    options.checkpoint_every = 4;
    const auto folder = folder_.path / name;
    if (!grid) return tiny_run(folder, folder_.path, options);
    redrive::Run run = tiny_grid_run(folder, folder_.path, options);
    dynamic_cast<RayModel&>(*run.state.model).error_rays = 0;
    return run;
  }
  /// Fresh runs of n processes, each in a folder of its own.
  std::vector<redrive::Run> fresh_runs(int n, const std::string& name, bool grid,
                                       int max_steps = 1) {
    std::vector<redrive::Run> runs;
    for (int rank = 0; rank < n; ++rank)
      runs.push_back(fresh_run(name + std::to_string(rank), grid, max_steps));
    return runs;
  }
  static std::deque<GroupRun> with_data(std::vector<redrive::Run> runs) {
    std::deque<GroupRun> out;  // elements refer to themselves
    for (redrive::Run& run : runs) out.emplace_back(std::move(run));
    return out;
  }
  /// Trains the runs, one in each process; `interference` with the steps of the last one. Returns
  /// how they ended.
  TrainEnd train_together(std::vector<redrive::Run>* runs, Interference* interference = nullptr) {
    std::vector<TrainEnd> ends(runs->size());
    run_processes(static_cast<int>(runs->size()), [&](int rank, ProcessGroup& processes) {
      redrive::Run& run = (*runs)[static_cast<std::size_t>(rank)];
      const bool last = interference && rank + 1 == processes.size();
      ThreadPool pool(1);
      const auto inner = processor_backend(1);
      Interference nothing;
      InterferingBackend backend(*inner, last ? interference : &nothing);
      const TrainingData data = load_training_data(run, pool);
      ends[static_cast<std::size_t>(rank)] =
          train(&run, data, backend, last ? interference->stop : never_, nullptr, &processes);
    });
    for (const TrainEnd end : ends) EXPECT_EQ(end, ends.front());
    return ends.front();
  }
};

inline double loss_of(const StepResult& result, std::string_view term) {
  for (const LossTerm& one : result.loss_terms)
    if (one.name == term) return one.value;
  return 0;
}

}  // namespace redrive
