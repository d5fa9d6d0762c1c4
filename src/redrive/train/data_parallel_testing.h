// SPDX-License-Identifier: Apache-2.0
// For tests of data-parallel steps: backends side by side with an all-reduce on the host, and runs
// that draw small batches.
#pragma once

#include <algorithm>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/model/tiny_grid_model_testing.h"
#include "redrive/train/data_parallel_group.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// Sums in the order of the backends.
class HostMean final : public kernels::AllReduce {
 public:
  explicit HostMean(const std::vector<kernels::Backend*>& backends) : backends_(backends) {}
  void mean(std::span<const std::span<float>> parts) override {
    ASSERT_EQ(parts.size(), backends_.size());
    for (std::size_t r = 0; r < parts.size(); ++r) backends_[r]->download(parts[r]);
    for (std::size_t i = 0; i < parts[0].size(); ++i) {
      float sum = 0;
      for (const std::span<float> part : parts) sum += part[i];
      for (const std::span<float> part : parts) part[i] = sum / static_cast<float>(parts.size());
    }
    for (std::size_t r = 0; r < parts.size(); ++r) backends_[r]->upload(parts[r]);
  }

 private:
  const std::vector<kernels::Backend*>& backends_;
};

/// Emulated devices, of which `troubled` injects faults.
struct Loops {
  std::vector<std::unique_ptr<kernels::Backend>> owned;
  std::vector<kernels::Backend*> all;

  explicit Loops(int n, int troubled = -1, kernels::InjectedFaults* faults = nullptr) {
    for (int r = 0; r < n; ++r) {
      owned.push_back(kernels::make_loop_backend(nullptr, true, r == troubled ? faults : nullptr));
      all.push_back(owned.back().get());
    }
  }
};

/// A run and its training set.
struct GroupRun {
  redrive::Run run;
  TrainingData data;
  PixelSampler sampler;
  LidarReturns returns;
  std::unique_ptr<LidarSampler> lidar;

  GroupRun(redrive::Run from, double cell_error = -1)
      : run(std::move(from)),
        data([this] {
          ThreadPool pool(1);
          return load_training_data(run, pool);
        }()),
        sampler(run.scene, data.images, 1) {
    if (cell_error < 0) return;
    run.state.cell_errors = Buffer<float>(sampler.cells().size());
    std::ranges::fill(run.state.cell_errors.span(), static_cast<float>(cell_error));
  }
  TrainingSet set() const { return {run.scene, data.images, returns, sampler, lidar.get()}; }
  /// Rays that each rank draws uniformly and by the error map.
  void draw(int uniform, int error_rays = 0) {
    auto& model = dynamic_cast<RayModel&>(*run.state.model);
    model.batch_rays = uniform + error_rays;
    model.error_rays = (error_rays + 0.5) / model.batch_rays;
    if (auto* grid = dynamic_cast<GridModel*>(&model)) grid->max_batch_factor = 1;
  }
  /// Adds LiDAR rays to each rank's batch, of returns 3 m ahead.
  void draw_lidar(int rays) {
    returns.n = 100;
    returns.origin.assign(300, 0);
    returns.direction.assign(300, 0);
    std::fill_n(returns.direction.begin(), 100, 1.0f);
    returns.range_m.assign(100, 3.0f);
    returns.t_ns.assign(100, 0);
    lidar = std::make_unique<LidarSampler>(returns, 1);
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
  GroupRun group_run(const std::string& name, bool grid = true, double cell_error = -1) {
    const TrainOptions options = tiny_options(1);
    const auto folder = folder_.path / name;
    return {grid ? tiny_grid_run(folder, folder_.path, options)
                 : tiny_run(folder, folder_.path, options),
            cell_error};
  }
  redrive::Run grid_run(const std::string& name, int max_steps) {
    TrainOptions options = tiny_options(max_steps);
    options.checkpoint_every = 4;
    return tiny_grid_run(folder_.path / name, folder_.path, options);
  }
  TrainEnd train_by(redrive::Run* run, const std::vector<kernels::Backend*>& backends,
                    kernels::AllReduce* all_reduce) {
    ThreadPool pool(1);
    return train(run, load_training_data(*run, pool), backends, all_reduce, never_);
  }
};

inline void fetch_state(kernels::Backend& backend, const TrainState& state) {
  const Buffer<float>& parameters = state.model->parameters;
  for (const Buffer<float>* numbers :
       {&parameters, &state.adam.first_moment, &state.adam.second_moment, &state.cell_errors})
    backend.download(*numbers);
}

inline double loss_of(const StepResult& result, std::string_view term) {
  for (const LossTerm& one : result.loss_terms)
    if (one.name == term) return one.value;
  return 0;
}

}  // namespace redrive
