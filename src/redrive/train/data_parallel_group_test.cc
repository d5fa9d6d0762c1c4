// SPDX-License-Identifier: Apache-2.0
// Data-parallel steps on several emulated devices with an all-reduce on the host, and on GPUs by
// NCCL where there are two.
#include "redrive/train/data_parallel_group.h"

#include <algorithm>
#include <barrier>
#include <cmath>
#include <deque>
#include <thread>

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

void fetch_state(kernels::Backend& backend, const TrainState& state) {
  const Buffer<float>& parameters = state.model->parameters;
  for (const Buffer<float>* numbers :
       {&parameters, &state.adam.first_moment, &state.adam.second_moment, &state.cell_errors})
    backend.download(*numbers);
}

double loss_of(const StepResult& result, std::string_view term) {
  for (const LossTerm& one : result.loss_terms)
    if (one.name == term) return one.value;
  return 0;
}

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

/// Processes as threads; collectives end when the last one has come.
struct Meeting {
  explicit Meeting(int n) : arrived(n), doubles(n), floats(n) {}
  std::barrier<> arrived;
  std::vector<std::span<const double>> doubles;
  std::vector<std::span<float>> floats;
};

class ThreadGroup final : public ProcessGroup {
 public:
  ThreadGroup(Meeting* meeting, int rank) : meeting_(*meeting), rank_(rank) {}
  int rank() const override { return rank_; }
  int size() const override { return static_cast<int>(meeting_.floats.size()); }
  void all_gather(std::span<const double> own, std::span<double> all) override {
    meeting_.doubles[rank_] = own;
    meeting_.arrived.arrive_and_wait();
    for (std::size_t r = 0; r < meeting_.doubles.size(); ++r)
      std::ranges::copy(meeting_.doubles[r], all.begin() + std::ssize(own) * std::ptrdiff_t(r));
    meeting_.arrived.arrive_and_wait();
  }
  void mean(std::span<float> numbers) override {
    meeting_.floats[rank_] = numbers;
    meeting_.arrived.arrive_and_wait();
    std::vector<float> means(numbers.size());
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      for (const std::span<float> part : meeting_.floats) means[i] += part[i];
      means[i] /= static_cast<float>(size());
    }
    meeting_.arrived.arrive_and_wait();
    std::ranges::copy(means, numbers.begin());
    meeting_.arrived.arrive_and_wait();
  }

 private:
  Meeting& meeting_;
  int rank_;
};

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

  Meeting meeting(kRanks);
  std::deque<GroupRun> runs;  // which refer to themselves
  for (int rank = 0; rank < kRanks; ++rank)
    runs.emplace_back(tiny_run(folder_.path / ("process " + std::to_string(rank)), folder_.path,
                               tiny_options(1)));
  std::vector<std::thread> threads;
  for (int rank = 0; rank < kRanks; ++rank)
    threads.emplace_back([&, rank] {
      GroupRun& of = runs[static_cast<std::size_t>(rank)];
      of.run.state = parse_checkpoint(before, "");
      ThreadGroup processes(&meeting, rank);
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
  for (std::thread& thread : threads) thread.join();
}

TEST_F(DataParallelTest, ARunOfProcessesIsWrittenByTheFirst) {
  constexpr int kRanks = 2;
  TrainOptions options = tiny_options(60);
  options.max_steps = 60;
  Meeting meeting(kRanks);
  std::vector<redrive::Run> runs;
  for (const char* name : {"first", "second"})
    runs.push_back(tiny_run(folder_.path / name, folder_.path, options));
  std::vector<std::thread> threads;
  for (int rank = 0; rank < kRanks; ++rank)
    threads.emplace_back([&, rank] {
      redrive::Run& run = runs[static_cast<std::size_t>(rank)];
      ThreadGroup processes(&meeting, rank);
      ThreadPool pool(1);
      const auto backend = processor_backend(1);
      const TrainingData data = load_training_data(run, pool);
      EXPECT_EQ(train(&run, data, {backend.get()}, nullptr, never_, nullptr, &processes),
                TrainEnd::kFinished);
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_TRUE(same_weights(runs[0].state, runs[1].state));
  EXPECT_EQ(runs[0].state.seconds, runs[1].state.seconds) << "one clock";
  EXPECT_EQ(load_checkpoint(runs[0].paths.checkpoint()).step, 60);
  EXPECT_EQ(read_metrics(runs[0].paths).size(), 3u);
  EXPECT_FALSE(std::filesystem::exists(runs[1].paths.checkpoint()));
  EXPECT_FALSE(std::filesystem::exists(runs[1].paths.metrics()));
}

TEST_F(DataParallelTest, ProcessesMustBeginAlike) {
  Meeting meeting(2);
  std::vector<redrive::Run> runs;
  for (const char* name : {"first", "second"})
    runs.push_back(tiny_run(folder_.path / name, folder_.path, tiny_options(60)));
  runs[1].state.model->parameters[3] += 1;
  std::vector<std::thread> threads;
  for (int rank = 0; rank < 2; ++rank)
    threads.emplace_back([&, rank] {
      redrive::Run& run = runs[static_cast<std::size_t>(rank)];
      run.state.step = 1;  // or nerf would begin anew
      ThreadGroup processes(&meeting, rank);
      ThreadPool pool(1);
      const auto backend = processor_backend(1);
      const TrainingData data = load_training_data(run, pool);
      EXPECT_THROW(train(&run, data, {backend.get()}, nullptr, never_, nullptr, &processes),
                   UsageError);
    });
  for (std::thread& thread : threads) thread.join();
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
