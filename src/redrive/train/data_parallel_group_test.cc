// SPDX-License-Identifier: Apache-2.0
// Steps by several devices, loops on the host, whose gradients are brought together there. The same
// team trains on GPUs, by NCCL, where there are two.
#include "redrive/train/data_parallel_group.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/nccl.h"
#include "redrive/model/tiny_grid_model_testing.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// In the order of the backends.
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

/// Loops, of which `troubled` has what is to go wrong.
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

/// A run and what its batches are gathered from.
struct TeamRun {
  redrive::Run run;
  TrainingData data;
  PixelSampler sampler;

  TeamRun(redrive::Run from, double cell_error = -1)
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
  std::function<void(Rank&)> gather(int even, int error_map_rays = 0) {
    return [=, this](Rank& member) {
      gather_batch(member.backend, sampler, even, error_map_rays, member.state, &member.batch,
                   &member.buffers, member.share);
      member.batch.refines = true;
    };
  }
};

class TeamTest : public TrainingTest {
 protected:
  TeamRun team_run(const std::string& name, bool grid = true, double cell_error = -1) {
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
                    kernels::AllReduce* reduction) {
    ThreadPool pool(1);
    return train(run, load_training_data(*run, pool), backends, reduction, never_);
  }
};

void fetch_state(kernels::Backend& backend, const TrainState& state) {
  const Buffer<float>& parameters = state.model->parameters;
  for (const Buffer<float>* numbers :
       {&parameters, &state.first_moment, &state.second_moment, &state.cell_errors})
    backend.download(*numbers);
}

/// A few LiDAR rays, others for each member.
void add_lidar(Rank* member) {
  constexpr int kRays = 5;
  RayBatch& lidar = member->lidar;
  lidar.n = kRays;
  lidar.first_ray = static_cast<std::uint64_t>(kRays) * member->share.rank;
  lidar.origin.assign(3 * kRays, 0.1f * static_cast<float>(member->share.rank));
  lidar.direction.assign(3 * kRays, 0);
  std::fill_n(lidar.direction.begin(), kRays, 1.0f);
  lidar.pixel_angle.assign(kRays, 0.002f);
  lidar.range_m.assign(kRays, 3.0f);
}

TEST_F(TeamTest, HalvesOfABatchMakeTheStepOfTheWhole) {
  constexpr int kRays = 64;
  for (const bool grid : {false, true}) {
    TeamRun whole = team_run(grid ? "whole grid" : "whole", grid),
            halves = team_run(grid ? "grid" : "halves", grid);
    const auto backend = kernels::make_loop_backend();
    RayBatch batch;
    StepBuffers buffers;
    gather_batch(*backend, whole.sampler, kRays, 0, &whole.run.state, &batch, &buffers);
    batch.refines = true;
    const StepResult expected = train_step(*backend, batch, 1e-3, &whole.run.state, &buffers);
    fetch_state(*backend, whole.run.state);

    const Loops loops(2);
    HostMean mean(loops.all);
    DataParallelGroup team(loops.all, &mean, &halves.run.state);
    team.begin();
    const StepResult result = team.step(halves.gather(kRays / 2), 1e-3);
    fetch_state(*loops.all[0], halves.run.state);

    EXPECT_TRUE(result.finite);
    EXPECT_EQ(result.rays, expected.rays);
    EXPECT_EQ(result.active_rays, expected.active_rays);
    EXPECT_EQ(halves.run.state.rays_drawn, whole.run.state.rays_drawn);
    EXPECT_EQ(halves.run.state.active_fraction, whole.run.state.active_fraction);
    // The same terms in another order: sums of so many of them, each rounded.
    const int samples = kRays * whole.run.state.model->samples_per_ray();
    const double rounding = samples * 0x1p-24;
    EXPECT_NEAR(result.rgb_mse, expected.rgb_mse, rounding * expected.rgb_mse);
    EXPECT_NEAR(result.opacity, expected.opacity, rounding);
    EXPECT_NEAR(result.colours, expected.colours, rounding * expected.colours);
    for (const ModelTensor& tensor : whole.run.state.model->tensors()) {
      if (tensor.name == "proposal")
        continue;  // learns from the first quarter of each half, not of the whole
      std::size_t size = 1;
      for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
      const auto of = [&](const TrainState& state) {
        return state.first_moment.span().subspan(tensor.offset, size);
      };
      float most = 0, difference = 0;
      for (std::size_t i = 0; i < size; ++i) {
        most = std::max(most, std::abs(of(whole.run.state)[i]));
        difference =
            std::max(difference, std::abs(of(whole.run.state)[i] - of(halves.run.state)[i]));
      }
      EXPECT_LE(difference, rounding * most) << tensor.name;
      EXPECT_TRUE(std::isfinite(most)) << tensor.name;
    }
    const std::vector<ViewGradient> views = team.view_gradients(whole.run.scene),
                                    of_whole = view_gradients(whole.run.scene, batch, expected);
    double most = 0;
    for (const ViewGradient& view : of_whole) most = std::max(most, view.d_translation.norm());
    EXPECT_GT(most, 0);
    for (std::size_t v = 0; v < views.size(); ++v) {
      EXPECT_LE((views[v].d_translation - of_whole[v].d_translation).norm(), rounding * most);
      EXPECT_LE((views[v].d_rotation - of_whole[v].d_rotation).norm(), rounding * most);
    }
  }
}

TEST_F(TeamTest, StaysOneFieldAndTakesInAllRays) {
  constexpr int kMembers = 3, kSteps = 4;
  TeamRun of = team_run("run", true, 0.5);
  const TrainState before = parse_checkpoint(checkpoint_bytes(of.run.state), "");
  const Loops loops(kMembers);
  HostMean mean(loops.all);
  DataParallelGroup team(loops.all, &mean, &of.run.state);
  team.begin();
  const auto gather = [&](Rank& member) {
    of.gather(16, 8)(member);
    add_lidar(&member);
  };
  std::vector<float> errors(before.cell_errors.span().begin(), before.cell_errors.span().end());
  for (int step = 0; step < kSteps; ++step) {
    const StepResult result = team.step(gather, 1e-2);
    EXPECT_TRUE(result.finite);
    EXPECT_EQ(result.rays, kMembers * 24);
    EXPECT_GT(result.range, 0);
    for (int rank = 0; rank < kMembers; ++rank) {
      const Rank& member = team[rank];
      fetch_state(member.backend, *member.state);
      EXPECT_TRUE(same_weights(*member.state, of.run.state)) << rank;
      EXPECT_EQ(member.state->step, step + 1);
      EXPECT_EQ(member.state->rays_drawn, (step + 1) * kMembers * 16u);
      update_error_map(member.batch.cell, member.result.squares, errors);
    }
    EXPECT_TRUE(bit_equal(of.run.state.cell_errors, errors));
    if (step > 0) continue;
    // The mean of what each would learn alone: Adam's first moment is a tenth of it.
    std::vector<double> gradient(before.model->size());
    for (int rank = 0; rank < kMembers; ++rank) {
      TrainState state = parse_checkpoint(checkpoint_bytes(before), "");
      Rank member{*loops.all[rank], {rank, kMembers}, &state};
      gather(member);
      step_gradients(member.backend, member.batch, state, &member.buffers, &member.lidar);
      member.backend.download(member.buffers.gradients);
      for (std::size_t i = 0; i < gradient.size(); ++i)
        gradient[i] += member.buffers.gradients[i] / kMembers;
    }
    int moved = 0;
    for (std::size_t i = 0; i < gradient.size(); ++i) {
      ASSERT_NEAR(of.run.state.first_moment[i], 0.1 * gradient[i],
                  1e-6 * std::abs(gradient[i]) + 1e-12)
          << i;
      moved += gradient[i] != 0;
    }
    EXPECT_GT(moved, 100);
  }
}

TEST_F(TeamTest, DrawsEachPixelOnceAnEpoch) {
  TeamRun of = team_run("run");
  const auto backend = kernels::make_ref_backend();
  const std::uint64_t pixels = of.sampler.pixels();
  for (const int members : {1, 2, 3, 5})
    for (const std::uint64_t left : {1, 2, 4, 7, 11}) {  // of the epoch
      TrainState& state = of.run.state;
      state.rays_drawn = pixels - left;
      while (state.rays_drawn < pixels + 5) {
        std::uint64_t drawn = 0;
        for (int rank = 0; rank < members; ++rank) {
          RayBatch batch, expected;
          StepBuffers buffers;
          gather_batch(*backend, of.sampler, 3, 0, &state, &batch, &buffers, {rank, members});
          EXPECT_EQ(batch.first_ray, drawn);
          EXPECT_GE(batch.n, 1);
          EXPECT_LE(batch.n, 3);
          for (int i = 0; i < batch.n; ++i, ++drawn) {
            of.sampler.gather(state.rays_drawn + drawn, 1, &expected);
            EXPECT_EQ(batch.direction[i], expected.direction[0])
                << members << " " << left << " " << drawn;
            EXPECT_EQ(batch.view[i], expected.view[0]);
          }
        }
        state.rays_drawn += drawn;
      }
    }
}

TEST_F(TeamTest, WhatIsNotFiniteForOneIsAppliedByNone) {
  for (const int bad : {0, 1}) {
    TeamRun of = team_run("run" + std::to_string(bad), true, 0.5);
    const TrainState before = parse_checkpoint(checkpoint_bytes(of.run.state), "");
    const Loops loops(2);
    HostMean mean(loops.all);
    DataParallelGroup team(loops.all, &mean, &of.run.state);
    team.begin();
    const auto gather = of.gather(16, 8);
    const StepResult result = team.step(
        [&](Rank& member) {
          gather(member);
          if (member.share.rank != bad) return;
          kernels::download(member.backend, member.batch.target);
          member.batch.target[5] = std::numeric_limits<float>::quiet_NaN();
          member.backend.upload(kernels::as_floats(std::span<const float>(member.batch.target)));
        },
        1e-2);
    EXPECT_FALSE(result.finite);
    for (int rank = 0; rank < 2; ++rank) {
      fetch_state(team[rank].backend, *team[rank].state);
      EXPECT_TRUE(same_weights(*team[rank].state, before));
      EXPECT_EQ(team[rank].state->step, 1);
    }
    EXPECT_TRUE(team.step(gather, 1e-2).finite) << "nothing of it is left";
  }
}

TEST_F(TeamTest, ADeviceLostAtAnyPartOfAStepEndsIt) {
  const TeamRun first = team_run("run", true, 0.5);
  const std::string before = checkpoint_bytes(first.run.state);
  TeamRun of = team_run("run again", true, 0.5);
  for (const int lost : {0, 1}) {
    int failures = 0;
    for (std::int64_t works = 0;; works += 5) {
      kernels::InjectedFaults faults{.works = works};
      const Loops loops(2, lost, &faults);
      HostMean mean(loops.all);
      of.run.state = parse_checkpoint(before, "");
      DataParallelGroup team(loops.all, &mean, &of.run.state);
      team.begin();
      try {
        team.step(of.gather(8, 4), 1e-2);
        break;
      } catch (const DeviceError& error) {
        const std::string which =
            works < 50 ? "GPU " + std::to_string(lost) + ": " : "";  // not while it is fetched
        EXPECT_THAT(error.what(), HasSubstr(which + "the GPU failed, computing: it was told to"));
        ++failures;
      }
    }
    EXPECT_GT(failures, 10);

    kernels::InjectedFaults faults{.places = 40};
    const Loops loops(2, lost, &faults);
    HostMean mean(loops.all);
    of.run.state = parse_checkpoint(before, "");
    DataParallelGroup team(loops.all, &mean, &of.run.state);
    team.begin();
    try {
      team.step(of.gather(8, 4), 1e-2);
      ADD_FAILURE() << "it had room";
    } catch (const DeviceMemoryError& error) {
      EXPECT_THAT(error.what(), HasSubstr("GPU " + std::to_string(lost) +
                                          ": --backend loop: the GPU has no memory"));
    }
  }
}

TEST_F(TeamTest, TrainsAndResumesWithAnotherNumber) {
  const Loops two(2);
  HostMean mean(two.all);
  redrive::Run whole = grid_run("whole", 10), again = grid_run("again", 10),
               fewer = grid_run("fewer", 6);
  EXPECT_EQ(train_by(&whole, two.all, &mean), TrainEnd::kFinished);
  EXPECT_EQ(train_by(&again, two.all, &mean), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(whole.state, again.state));
  EXPECT_EQ(curve(whole), curve(again));
  EXPECT_EQ(whole.state.poses.moments.updates, 2);
  EXPECT_LT(*std::ranges::min_element(whole.state.cell_errors.span()), kInitialError);
  EXPECT_TRUE(same_weights(load_checkpoint(whole.paths.checkpoint()), whole.state));

  EXPECT_EQ(train_by(&fewer, two.all, &mean), TrainEnd::kFinished);
  const std::uint64_t drawn = fewer.state.rays_drawn;
  redrive::Run one = reopened(fewer);
  one.options.max_steps = 10;
  EXPECT_EQ(train_by(&one, {two.all[0]}, nullptr), TrainEnd::kFinished);
  EXPECT_EQ(one.state.step, 10);
  EXPECT_LT(one.state.rays_drawn - drawn, drawn / 2)
      << "two thirds of the steps, half as many rays";
}

TEST_F(TeamTest, InterruptedAndResumedEndsAsUninterrupted) {
  const Loops two(2);
  HostMean mean(two.all);
  redrive::Run whole = grid_run("whole", 10), parts = grid_run("parts", 10);
  EXPECT_EQ(train_by(&whole, two.all, &mean), TrainEnd::kFinished);
  kernels::InjectedFaults faults{.works = 700};
  const Loops failing(2, 1, &faults);
  HostMean mean_of_failing(failing.all);
  try {
    train_by(&parts, failing.all, &mean_of_failing);
    ADD_FAILURE() << "it did not fail";
  } catch (const DeviceError& error) {
    EXPECT_THAT(error.what(),
                HasSubstr("the last checkpoint stands, go on from it with: redrive resume "));
  }
  parts = reopened(parts);
  EXPECT_GT(parts.state.step, 0);
  EXPECT_LT(parts.state.step, 10);
  EXPECT_EQ(train_by(&parts, two.all, &mean), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(parts.state, whole.state));
  EXPECT_EQ(parts.state.poses.corrections.values, whole.state.poses.corrections.values);
  EXPECT_EQ(curve(parts), curve(whole));
}

TEST_F(TeamTest, BeginsAgainTogether) {
  for (const int bad : {0, 1}) {
    const Loops two(2);
    HostMean of_two(two.all);
    Interference interference{.nan_from = 3, .nan_to = 4};
    InterferingBackend spoilt(*two.all[bad], &interference);
    std::vector<kernels::Backend*> backends = two.all;
    backends[bad] = &spoilt;
    HostMean mean(backends);
    redrive::Run restarted = grid_run("restarted" + std::to_string(bad), 6),
                 fresh = grid_run("fresh" + std::to_string(bad), 6);
    EXPECT_EQ(train_by(&restarted, backends, &mean), TrainEnd::kFinished);
    EXPECT_EQ(restarted.state.restarts, 1);
    fresh.state = initial_state(std::move(fresh.state.model), restarted.state.seed);
    fresh.state.poses = PoseState(fresh.scene);
    EXPECT_EQ(train_by(&fresh, two.all, &of_two), TrainEnd::kFinished);
    EXPECT_TRUE(same_weights(restarted.state, fresh.state)) << "nobody goes on from what it had";
  }
}

/// NCCL among as many GPUs as there are; a mean of one is what it was.
TEST(NcclAllReduce, OnGpusIsTheMean) {
  if (const auto obstacle = kernels::cuda_obstacle()) GTEST_SKIP() << "cuda: " << *obstacle;
  if (const auto obstacle = kernels::nccl_obstacle()) GTEST_SKIP() << "nccl: " << *obstacle;
  std::vector<std::unique_ptr<kernels::Backend>> backends;
  std::vector<Buffer<float>> numbers;
  for (int gpu = 0; gpu < kernels::cuda_gpus() && !kernels::cuda_obstacle(gpu); ++gpu) {
    backends.push_back(kernels::make_cuda_backend(1, true, gpu));
    numbers.emplace_back(1000);
    for (std::size_t i = 0; i < 1000; ++i) numbers.back()[i] = static_cast<float>(i + 2 * gpu);
    kernels::make_resident(*backends.back(), numbers.back());
  }
  const auto reduction = kernels::make_nccl_all_reduce(backends);
  const std::vector<std::span<float>> parts(numbers.begin(), numbers.end());
  reduction->mean(parts);
  const auto gpus = static_cast<float>(backends.size());
  for (std::size_t r = 0; r < parts.size(); ++r) {
    backends[r]->download(parts[r]);
    for (std::size_t i = 0; i < 1000; ++i)
      ASSERT_NEAR(parts[r][i], static_cast<float>(i) + gpus - 1, 1e-3) << r;
    EXPECT_TRUE(bit_equal(parts[r], parts[0]));
  }
}

TEST_F(TeamTest, OnGpusLearnsAsOneWithTheLargerBatch) {
  if (kernels::cuda_gpus() < 2) GTEST_SKIP() << "cuda: fewer than two GPUs";
  if (const auto obstacle = kernels::nccl_obstacle()) GTEST_SKIP() << "nccl: " << *obstacle;
  const kernels::BackendGroup two = kernels::make_backend_group({"cuda", "auto", 2}, 2);
  const std::vector<kernels::Backend*> both = {two.backends[0].get(), two.backends[1].get()};
  redrive::Run team = grid_run("team", 100), one = grid_run("one", 100);
  one.options.batch_rays *= 2;
  EXPECT_EQ(train_by(&team, both, two.reduction.get()), TrainEnd::kFinished);
  EXPECT_EQ(train_by(&one, {both[0]}, nullptr), TrainEnd::kFinished);
  const auto rows = read_metrics(team.paths), expected = read_metrics(one.paths);
  ASSERT_EQ(rows.size(), expected.size());
  EXPECT_GT(rows.back().psnr_db, rows.front().psnr_db);
  EXPECT_NEAR(rows.back().psnr_db, expected.back().psnr_db, 1);
}

}  // namespace
}  // namespace redrive
