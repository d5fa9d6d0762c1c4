// SPDX-License-Identifier: Apache-2.0
// Data-parallel steps on several emulated devices with an all-reduce on the host, and on GPUs by
// NCCL where there are two.
#include "redrive/train/data_parallel_group.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/nccl.h"
#include "redrive/train/data_parallel_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TEST_F(DataParallelTest, TwoHalvesOfABatchEqualTheWholeBatch) {
  constexpr int kRays = 64;
  for (const bool grid : {false, true}) {
    GroupRun whole = group_run(grid ? "whole grid" : "whole", grid),
             halves = group_run(grid ? "grid" : "halves", grid);
    whole.draw(kRays);
    halves.draw(kRays / 2);
    const auto backend = kernels::make_loop_backend();
    StepBuffers buffers;
    const StepResult expected =
        train_step(*backend, whole.set(), whole.next(), 1e-3, &whole.run.state, &buffers);
    fetch_state(*backend, whole.run.state);

    const Loops loops(2);
    HostMean mean(loops.all);
    DataParallelGroup group(loops.all, &mean, &halves.run.state);
    group.begin();
    const StepResult result = group.step(halves.set(), halves.next(), 1e-3);
    fetch_state(*loops.all[0], halves.run.state);

    EXPECT_TRUE(result.finite);
    EXPECT_EQ(result.pixels, expected.pixels);
    EXPECT_EQ(result.active_rays, expected.active_rays);
    EXPECT_EQ(halves.run.state.pixels_drawn, whole.run.state.pixels_drawn);
    if (grid) {
      const auto fraction = [](const GroupRun& of) {
        return dynamic_cast<const GridModel&>(*of.run.state.model).active_fraction;
      };
      EXPECT_EQ(fraction(halves), fraction(whole));
    }
    // Bounds the rounding of sums of the same terms in another order.
    const int samples = kRays * ray_model(whole.run.state).samples_per_ray();
    const double rounding = samples * 0x1p-24;
    EXPECT_NEAR(result.rgb_mse, expected.rgb_mse, rounding * expected.rgb_mse);
    EXPECT_NEAR(result.opacity, expected.opacity, rounding);
    const double colour = loss_of(expected, "colour");
    EXPECT_GT(colour, 0);
    EXPECT_NEAR(loss_of(result, "colour"), colour, rounding * colour);
    for (const ModelTensor& tensor : whole.run.state.model->tensors()) {
      if (tensor.name == "proposal")
        continue;  // trained on the first quarter of each half, not of the whole
      std::size_t size = 1;
      for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
      const auto of = [&](const TrainState& state) {
        return state.adam.first_moment.span().subspan(tensor.offset, size);
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
    double most = 0;
    for (const ViewGradient& view : expected.views)
      most = std::max(most, view.d_translation.norm());
    EXPECT_GT(most, 0);
    ASSERT_EQ(result.views.size(), expected.views.size());
    for (std::size_t v = 0; v < result.views.size(); ++v) {
      const ViewGradient &a = result.views[v], &b = expected.views[v];
      EXPECT_LE((a.d_translation - b.d_translation).norm(), rounding * most);
      EXPECT_LE((a.d_rotation - b.d_rotation).norm(), rounding * most);
    }
  }
}

TEST_F(DataParallelTest, RanksStayEqualAndAllUpdateTheErrorMap) {
  constexpr int kRanks = 3, kSteps = 4;
  GroupRun of = group_run("run", true, 0.5);
  of.draw(16, 8);
  of.draw_lidar(5);
  const TrainState before = parse_checkpoint(checkpoint_bytes(of.run.state), "");
  const Loops loops(kRanks);
  HostMean mean(loops.all);
  DataParallelGroup group(loops.all, &mean, &of.run.state);
  group.begin();
  std::vector<float> errors(before.cell_errors.span().begin(), before.cell_errors.span().end());
  for (int step = 0; step < kSteps; ++step) {
    const StepResult result = group.step(of.set(), of.next(), 1e-2);
    EXPECT_TRUE(result.finite);
    EXPECT_EQ(result.pixels, kRanks * 24);
    EXPECT_GT(loss_of(result, "lidar"), 0);
    for (int r = 0; r < kRanks; ++r) {
      const Rank& rank = group[r];
      fetch_state(rank.backend, *rank.state);
      EXPECT_TRUE(same_weights(*rank.state, of.run.state)) << r;
      EXPECT_EQ(rank.state->step, step + 1);
      EXPECT_EQ(rank.state->pixels_drawn, (step + 1) * kRanks * 16u);
      update_error_map(rank.result.cells, rank.result.squared_errors, errors);
    }
    EXPECT_TRUE(bit_equal(of.run.state.cell_errors, errors));
    if (step > 0) continue;
    // The mean of the ranks' own gradients; Adam's first moment is a tenth of it.
    std::vector<double> gradient(before.model->size());
    for (int r = 0; r < kRanks; ++r) {
      const TrainState state = parse_checkpoint(checkpoint_bytes(before), "");
      StepBuffers buffers;
      StepRequest request = next_step(state);
      request.rank = r;
      request.world_size = kRanks;
      kernels::Backend& backend = *loops.all[r];
      step_gradients(backend, of.set(), request, state, &buffers);
      backend.download(buffers.gradients);
      for (std::size_t i = 0; i < gradient.size(); ++i)
        gradient[i] += buffers.gradients[i] / kRanks;
    }
    int changed = 0;
    for (std::size_t i = 0; i < gradient.size(); ++i) {
      ASSERT_NEAR(of.run.state.adam.first_moment[i], 0.1 * gradient[i],
                  1e-6 * std::abs(gradient[i]) + 1e-12)
          << i;
      changed += gradient[i] != 0;
    }
    EXPECT_GT(changed, 100);
  }
}

TEST_F(DataParallelTest, DrawsEachPixelOnceAnEpoch) {
  GroupRun of = group_run("run");
  const auto backend = kernels::make_ref_backend();
  const std::uint64_t pixels = of.sampler.pixels();
  for (const int ranks : {1, 2, 3, 5})
    for (const std::uint64_t left : {1, 2, 4, 7, 11}) {  // of the epoch
      TrainState& state = of.run.state;
      state.pixels_drawn = pixels - left;
      while (state.pixels_drawn < pixels + 5) {
        std::uint64_t drawn = 0;
        for (int rank = 0; rank < ranks; ++rank) {
          RayBatch expected;
          RayBuffers buffers;
          StepRequest request = next_step(state);
          request.rank = rank;
          request.world_size = ranks;
          draw_batch(*backend, of.sampler, 3, 0, request, &buffers);
          const RayBatch& batch = buffers.batch;
          EXPECT_EQ(batch.first_ray, drawn);
          EXPECT_GE(batch.n, 1);
          EXPECT_LE(batch.n, 3);
          for (int i = 0; i < batch.n; ++i, ++drawn) {
            of.sampler.gather(state.pixels_drawn + drawn, 1, &expected);
            EXPECT_EQ(batch.direction[i], expected.direction[0])
                << ranks << " " << left << " " << drawn;
            EXPECT_EQ(batch.view[i], expected.view[0]);
          }
        }
        state.pixels_drawn += drawn;
      }
    }
}

TEST_F(DataParallelTest, NoRankAppliesAStepThatIsNotFiniteForOne) {
  for (const int bad : {0, 1}) {
    GroupRun of = group_run("run" + std::to_string(bad), true, 0.5);
    of.draw(16, 8);
    const TrainState before = parse_checkpoint(checkpoint_bytes(of.run.state), "");
    const Loops loops(2);
    Interference interference{.nan_from = 0, .nan_to = 1};
    InterferingBackend spoilt(*loops.all[bad], &interference);
    std::vector<kernels::Backend*> backends = loops.all;
    backends[bad] = &spoilt;
    HostMean mean(backends);
    DataParallelGroup group(backends, &mean, &of.run.state);
    group.begin();
    EXPECT_FALSE(group.step(of.set(), of.next(), 1e-2).finite);
    for (int rank = 0; rank < 2; ++rank) {
      fetch_state(group[rank].backend, *group[rank].state);
      EXPECT_TRUE(same_weights(*group[rank].state, before));
      EXPECT_EQ(group[rank].state->step, 1);
    }
    EXPECT_TRUE(group.step(of.set(), of.next(), 1e-2).finite) << "the next step is unaffected";
  }
}

TEST_F(DataParallelTest, ADeviceLostAtAnyPhaseEndsTheStep) {
  GroupRun first = group_run("run", true, 0.5);
  first.draw(8, 4);
  const std::string before = checkpoint_bytes(first.run.state);
  GroupRun of = group_run("run again", true, 0.5);
  for (const int lost : {0, 1}) {
    int failures = 0;
    for (std::int64_t launches = 0;; launches += 5) {
      kernels::InjectedFaults faults{.kernel_launches = launches};
      const Loops loops(2, lost, &faults);
      HostMean mean(loops.all);
      of.run.state = parse_checkpoint(before, "");
      DataParallelGroup group(loops.all, &mean, &of.run.state);
      group.begin();
      try {
        group.step(of.set(), of.next(), 1e-2);
        break;
      } catch (const DeviceError& error) {
        const std::string which =
            launches < 50 ? "GPU " + std::to_string(lost) + ": " : "";  // not while downloading
        EXPECT_THAT(error.what(), HasSubstr(which + "the GPU failed, computing: injected fault"));
        ++failures;
      }
    }
    EXPECT_GT(failures, 10);

    kernels::InjectedFaults faults{.allocations = 40};
    const Loops loops(2, lost, &faults);
    HostMean mean(loops.all);
    of.run.state = parse_checkpoint(before, "");
    DataParallelGroup group(loops.all, &mean, &of.run.state);
    group.begin();
    try {
      group.step(of.set(), of.next(), 1e-2);
      ADD_FAILURE() << "did not run out of memory";
    } catch (const DeviceMemoryError& error) {
      EXPECT_THAT(error.what(), HasSubstr("GPU " + std::to_string(lost) +
                                          ": --backend loop: the GPU has no memory"));
    }
  }
}

TEST_F(DataParallelTest, TrainsAndResumesWithAnotherNumberOfRanks) {
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
  const std::uint64_t drawn = fewer.state.pixels_drawn;
  redrive::Run one = reopened(fewer);
  one.options.max_steps = 10;
  EXPECT_EQ(train_by(&one, {two.all[0]}, nullptr), TrainEnd::kFinished);
  EXPECT_EQ(one.state.step, 10);
  EXPECT_LT(one.state.pixels_drawn - drawn, drawn / 2)
      << "two thirds of the steps, half as many rays";
}

TEST_F(DataParallelTest, InterruptedAndResumedEndsAsUninterrupted) {
  const Loops two(2);
  HostMean mean(two.all);
  redrive::Run whole = grid_run("whole", 10), parts = grid_run("parts", 10);
  EXPECT_EQ(train_by(&whole, two.all, &mean), TrainEnd::kFinished);
  kernels::InjectedFaults faults{.kernel_launches = 700};
  const Loops failing(2, 1, &faults);
  HostMean mean_of_failing(failing.all);
  try {
    train_by(&parts, failing.all, &mean_of_failing);
    ADD_FAILURE() << "did not fail";
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

TEST_F(DataParallelTest, AllRanksRestartTogether) {
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
    EXPECT_TRUE(same_weights(restarted.state, fresh.state)) << "no rank keeps its old state";
  }
}

/// NCCL on all GPUs; the mean over one GPU is its own value.
TEST(NcclAllReduce, ComputesTheMeanOnGpus) {
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

TEST_F(DataParallelTest, OnGpusTrainsAsOneWithTheLargerBatch) {
  if (kernels::cuda_gpus() < 2) GTEST_SKIP() << "cuda: fewer than two GPUs";
  if (const auto obstacle = kernels::nccl_obstacle()) GTEST_SKIP() << "nccl: " << *obstacle;
  const kernels::BackendGroup two = kernels::make_backend_group({"cuda", "auto", 2}, 2);
  const std::vector<kernels::Backend*> both = {two.backends[0].get(), two.backends[1].get()};
  redrive::Run parallel = grid_run("parallel", 100), one = grid_run("one", 100);
  dynamic_cast<RayModel&>(*one.state.model).batch_rays *= 2;
  EXPECT_EQ(train_by(&parallel, both, two.reduction.get()), TrainEnd::kFinished);
  EXPECT_EQ(train_by(&one, {both[0]}, nullptr), TrainEnd::kFinished);
  const auto rows = read_metrics(parallel.paths), expected = read_metrics(one.paths);
  ASSERT_EQ(rows.size(), expected.size());
  EXPECT_GT(rows.back().psnr_db, rows.front().psnr_db);
  EXPECT_NEAR(rows.back().psnr_db, expected.back().psnr_db, 1);
}

}  // namespace
}  // namespace redrive
