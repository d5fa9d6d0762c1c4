// SPDX-License-Identifier: Apache-2.0
// Data-parallel steps and runs of several processes, which are threads here.
#include "redrive/train/distributed/data_parallel.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/train/distributed/data_parallel_testing.h"

namespace redrive {
namespace {

TEST(RunProcesses, AFailureEndsTheOthers) {
  EXPECT_THROW(run_processes(3,
                             [](int rank, ProcessGroup& group) {
                               if (rank == 1) throw IoError("disk", "full");
                               std::vector<float> numbers(2);
                               group.mean(numbers);
                             }),
               IoError);
}

TEST_F(DataParallelTest, ThreadsWithABackendEachShareAField) {
  TrainOptions options = tiny_options(2), splats = options;
  splats.method = "splat";
  splats.hyperparameters.clear();
  splats.set("initial.sky", 800);
  std::vector<redrive::Run> runs;
  runs.push_back(run_named("nerf", options));
  runs.push_back(tiny_grid_run(folder_.path / "grid", folder_.path, options));
  runs.push_back(run_named("splat", splats));
  for (redrive::Run& run : runs) {
    train(&run, *backend_, never_);
    const Field& field = *run.field();
    const RayTable rays = make_ray_table(run.scene.rig[0].camera);
    const ShutterPoses poses = run.scene.shutter_poses(run.scene.views[0]);
    const RenderedImage expected = field.render(*processor_backend(1), rays, poses, {});
    std::vector<RenderedImage> images(3);
    std::vector<std::thread> threads;
    for (RenderedImage& image : images)
      threads.emplace_back([&] { image = field.render(*processor_backend(1), rays, poses, {}); });
    for (std::thread& thread : threads) thread.join();
    for (const RenderedImage& image : images) {
      EXPECT_TRUE(bit_equal(image.rgb, expected.rgb)) << field.method();
      EXPECT_TRUE(bit_equal(image.depth, expected.depth)) << field.method();
    }
  }
}

TEST_F(DataParallelTest, TwoHalvesOfABatchEqualTheWholeBatch) {
  constexpr int kRays = 64;
  for (const bool grid : {false, true}) {
    GroupRun whole(fresh_run(grid ? "whole grid" : "whole", grid));
    whole.draw(kRays);
    StepBuffers buffers;
    const StepResult expected =
        train_step(*backend_, whole.set(), whole.next(), 1e-3, &whole.run.state, &buffers);

    std::deque<GroupRun> both = with_data(fresh_runs(2, grid ? "grid" : "halves", grid));
    std::vector<StepResult> results(2);
    run_processes(2, [&](int rank, ProcessGroup& processes) {
      GroupRun& half = both[static_cast<std::size_t>(rank)];
      half.draw(kRays / 2);
      const auto backend = processor_backend(1);
      StepBuffers own;
      results[static_cast<std::size_t>(rank)] =
          train_step({*backend, &processes}, half.set(), half.next(), 1e-3, &half.run.state, &own);
    });
    const StepResult& result = results.front();
    const GroupRun& halves = both.front();

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

TEST_F(DataParallelTest, ProcessesStayEqualAndApplyTheMeanGradient) {
  constexpr int kRanks = 3, kSteps = 4;
  std::deque<GroupRun> runs = with_data(fresh_runs(kRanks, "run", true));
  for (GroupRun& of : runs) {
    of.draw(16);
    of.draw_lidar(5);
  }
  const std::string before = checkpoint_bytes(runs[0].run.state);
  std::vector<float> first_moment;
  run_processes(kRanks, [&](int rank, ProcessGroup& processes) {
    GroupRun& of = runs[static_cast<std::size_t>(rank)];
    of.run.state = parse_checkpoint(before, "");
    const auto backend = processor_backend(1);
    StepBuffers buffers;
    for (int step = 0; step < kSteps; ++step) {
      const StepResult result =
          train_step({*backend, &processes}, of.set(), of.next(), 1e-2, &of.run.state, &buffers);
      EXPECT_TRUE(result.finite);
      EXPECT_EQ(result.pixels, kRanks * 16);
      EXPECT_GT(loss_of(result, "lidar"), 0);
      EXPECT_EQ(of.run.state.step, step + 1);
      EXPECT_EQ(of.run.state.pixels_drawn, (step + 1) * kRanks * 16u);
      const std::span<const float> moment = of.run.state.adam.first_moment;
      if (step == 0 && rank == 0) first_moment.assign(moment.begin(), moment.end());
    }
  });
  for (const GroupRun& of : runs) EXPECT_TRUE(same_weights(of.run.state, runs[0].run.state));
  // Adam's first moment is a tenth of the mean of the ranks' own gradients.
  std::vector<double> gradient(first_moment.size());
  for (int rank = 0; rank < kRanks; ++rank) {
    const TrainState state = parse_checkpoint(before, "");
    const auto backend = processor_backend(1);
    StepBuffers buffers;
    StepRequest request = next_step(state);
    request.rank = rank;
    request.world_size = kRanks;
    step_gradients(*backend, runs[0].set(), request, state, &buffers);
    for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] += buffers.gradients[i] / kRanks;
  }
  int changed = 0;
  for (std::size_t i = 0; i < gradient.size(); ++i) {
    ASSERT_NEAR(first_moment[i], 0.1 * gradient[i], 1e-6 * std::abs(gradient[i]) + 1e-12) << i;
    changed += gradient[i] != 0;
  }
  EXPECT_GT(changed, 100);
}

TEST_F(DataParallelTest, DrawsEachPixelOnceAnEpoch) {
  GroupRun of(fresh_run("run", true));
  const std::uint64_t pixels = of.sampler.pixels();
  for (const int ranks : {1, 2, 3, 5})
    for (const std::uint64_t left : {1, 2, 4, 7, 11}) {  // steps left in the epoch
      TrainState& state = of.run.state;
      state.pixels_drawn = pixels - left;
      while (state.pixels_drawn < pixels + 5) {
        std::uint64_t drawn = 0;
        for (int rank = 0; rank < ranks; ++rank) {
          RayBatch batch, expected;
          StepRequest request = next_step(state);
          request.rank = rank;
          request.world_size = ranks;
          draw_batch(of.sampler, 3, 0, request, &batch);
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

TEST_F(DataParallelTest, NoProcessAppliesAStepThatIsNotFiniteForOne) {
  std::deque<GroupRun> runs = with_data(fresh_runs(2, "run", true));
  const std::string before = checkpoint_bytes(runs[0].run.state);
  run_processes(2, [&](int rank, ProcessGroup& processes) {
    GroupRun& of = runs[static_cast<std::size_t>(rank)];
    of.draw(16);
    Interference interference;
    if (rank == 1) {
      interference.nan_from = 0;
      interference.nan_to = 1;
    }
    const auto inner = processor_backend(1);
    InterferingBackend backend(*inner, &interference);
    StepBuffers buffers;
    const auto step = [&] {
      return train_step({backend, &processes}, of.set(), of.next(), 1e-2, &of.run.state, &buffers);
    };
    EXPECT_FALSE(step().finite);
    EXPECT_TRUE(same_weights(of.run.state, parse_checkpoint(before, "")));
    EXPECT_EQ(of.run.state.step, 1);
    EXPECT_TRUE(step().finite) << "the next step is unaffected";
  });
}

TEST_F(DataParallelTest, TrainsAndResumesWithAnotherNumberOfProcesses) {
  std::vector<redrive::Run> whole = fresh_runs(2, "whole", true, 10),
                            again = fresh_runs(2, "again", true, 10),
                            fewer = fresh_runs(2, "fewer", true, 6);
  EXPECT_EQ(train_together(&whole), TrainEnd::kFinished);
  EXPECT_EQ(train_together(&again), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(whole[0].state, again[0].state));
  EXPECT_EQ(curve(whole[0]), curve(again[0]));
  EXPECT_EQ(whole[0].state.poses.moments.updates, 2);

  EXPECT_EQ(train_together(&fewer), TrainEnd::kFinished);
  const std::uint64_t drawn = fewer[0].state.pixels_drawn;
  redrive::Run one = reopened(fewer[0]);
  one.options.max_steps = 10;
  EXPECT_EQ(train(&one, *backend_, never_), TrainEnd::kFinished);
  EXPECT_EQ(one.state.step, 10);
  EXPECT_LT(one.state.pixels_drawn - drawn, drawn / 2)
      << "two thirds of the steps, half as many rays";
}

TEST_F(DataParallelTest, InterruptedAndResumedEndsAsUninterrupted) {
  std::vector<redrive::Run> whole = fresh_runs(2, "whole", false, 10),
                            parts = fresh_runs(2, "parts", false, 10);
  EXPECT_EQ(train_together(&whole), TrainEnd::kFinished);
  Interference interference{.stop_after = 5};  // in one of them
  EXPECT_EQ(train_together(&parts, &interference), TrainEnd::kInterrupted);
  EXPECT_EQ(parts[0].state.step, 6);
  std::vector<redrive::Run> resumed;
  for (int rank = 0; rank < 2; ++rank) resumed.push_back(reopened(parts[0]));
  EXPECT_EQ(train_together(&resumed), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(resumed[0].state, whole[0].state));
  EXPECT_EQ(curve(resumed[0]), curve(whole[0]));
}

TEST_F(DataParallelTest, AllProcessesRestartTogether) {
  std::vector<redrive::Run> restarted = fresh_runs(2, "restarted", false, 6),
                            fresh = fresh_runs(2, "fresh", false, 6);
  Interference interference{.nan_from = 3, .nan_to = 4};  // in one of them
  EXPECT_EQ(train_together(&restarted, &interference), TrainEnd::kFinished);
  EXPECT_EQ(restarted[0].state.restarts, 1);
  EXPECT_EQ(restarted[1].state.restarts, 1);
  for (redrive::Run& run : fresh)
    run.state = initial_state(std::move(run.state.model), restarted[0].state.seed);
  EXPECT_EQ(train_together(&fresh), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(restarted[0].state, fresh[0].state)) << "none keeps its old state";
}

TEST_F(DataParallelTest, ARunOfProcessesIsWrittenByTheFirst) {
  TrainOptions options = tiny_options(60);
  options.max_steps = 60;
  std::vector<redrive::Run> runs;
  for (const char* name : {"first", "second"})
    runs.push_back(tiny_run(folder_.path / name, folder_.path, options));
  EXPECT_EQ(train_together(&runs), TrainEnd::kFinished);
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
    for (redrive::Run& run : runs) run.state.step = 1;  // or nerf would begin anew
    if (k + 1 == changes.size())
      EXPECT_NO_THROW(train_together(&runs));
    else
      EXPECT_THROW(train_together(&runs), UsageError) << k;
  }
}

}  // namespace
}  // namespace redrive
