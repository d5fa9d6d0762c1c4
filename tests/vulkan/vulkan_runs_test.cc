// SPDX-License-Identifier: Apache-2.0
// Runs on the first Vulkan device: failing devices, resuming on another backend, memory.
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/train/distributed/data_parallel_testing.h"
#include "tests/vulkan/wrapped_api.h"

namespace redrive {
namespace {

using ::testing::StartsWith;
using WrappedApi = kernels::vulkan::testing::WrappedApi;

class VulkanRuns : public TrainingTest {
 protected:
  void SetUp() override {
    try {
      kernels::make_vulkan_backend("0", 1);
    } catch (const UsageError& error) {
      GTEST_SKIP() << error.what();
    }
  }
  static std::unique_ptr<kernels::Backend> gpu() { return kernels::make_vulkan_backend("0", 1); }

  /// A run on images of the sky alone, whose Gaussians become more at steps 5 and 10.
  redrive::Run splat_run(const std::string& name, std::int64_t max_steps) {
    TrainOptions options;
    options.recording = "in memory";
    options.method = "splat";
    options.max_steps = max_steps;
    options.max_seconds = 0;
    options.checkpoint_every = 2;
    options.set("initial.sky", 200);
    options.set("max_gaussians", 1000);
    options.set("densify_every", 5);
    options.set("lr_gamma", 0.03);     // backends drift apart less
    options.set("averaged_every", 2);  // the last step of 12 counts
    return tiny_run(folder_.path / name, folder_.path, options);
  }
  /// Trains until 4 steps are done and saved.
  redrive::Run begun(const std::string& name, kernels::Backend& backend) {
    redrive::Run run = splat_run(name, 12);
    train_to(&run, backend, 4);
    return reopened(run);
  }
  /// Trains to this step, as if the options said so.
  static void train_to(redrive::Run* run, kernels::Backend& backend, std::int64_t step) {
    const std::int64_t all = run->options.max_steps;
    run->options.max_steps = step;
    const std::atomic<bool> never{false};
    EXPECT_EQ(train(run, backend, never), TrainEnd::kFinished);
    run->options.max_steps = all;
  }
};

/// Fails at each call: every other one.
class VulkanFailures : public VulkanRuns, public ::testing::WithParamInterface<int> {};
INSTANTIATE_TEST_SUITE_P(Calls, VulkanFailures, ::testing::Values(0, 1));

TEST_P(VulkanFailures, EndTheRunAfterItsLastCheckpoint) {
  constexpr std::int64_t kEnd = 7;  // Gaussians are split in step 5, and step 6 is saved
  redrive::Run whole = begun("whole", *gpu());
  const std::string saved = read_file(whole.paths.checkpoint(), std::uint64_t{1} << 30);
  WrappedApi api;
  train_to(&whole, *gpu(), kEnd);
  const std::string expected = checkpoint_bytes(whole.state);
  const int calls = api.calls;
  EXPECT_GT(calls, 200);
  EXPECT_EQ(api.alive, 0);

  int of_saved[2] = {0, 0};
  for (int at = 1 + GetParam(); at <= calls; at += 2) {
    SCOPED_TRACE("call " + std::to_string(at) + " of " + std::to_string(calls));
    const bool lacks_memory = at / 2 % 2;
    api.failure = lacks_memory ? VK_ERROR_OUT_OF_DEVICE_MEMORY : VK_ERROR_DEVICE_LOST;
    write_file(whole.paths.checkpoint(), saved);
    redrive::Run again = reopened(whole);
    api.calls = 0;
    api.fail_at = at;
    std::string message;
    try {
      const auto backend = gpu();
      train_to(&again, *backend, kEnd);
    } catch (const DeviceError& error) {
      message = error.what();
    }
    EXPECT_EQ(api.alive, 0) << "objects of Vulkan are left";
    const TrainState left = load_checkpoint(whole.paths.checkpoint());
    if (left.step == kEnd) {  // nothing but waiting for the end was left to do
      EXPECT_GT(at, calls - 8);
      continue;
    }
    EXPECT_THAT(message,
                ::testing::HasSubstr(lacks_memory ? "out of device memory" : "device lost"));
    ASSERT_TRUE(left.step == 4 || left.step == 6) << left.step;
    if (++of_saved[left.step == 6] > 1) continue;
    api.fail_at = 0;
    redrive::Run resumed = reopened(whole);
    train_to(&resumed, *gpu(), kEnd);
    TrainState& end = resumed.state;
    end.seconds = whole.state.seconds;
    end.window.seconds = whole.state.window.seconds;
    EXPECT_EQ(checkpoint_bytes(end), expected) << "what was killed and resumed has the same bits";
  }
  EXPECT_GT(of_saved[0], 0);
  EXPECT_GT(of_saved[1], 0);
}

TEST_F(VulkanRuns, GoOnAndRenderOnTheOtherBackend) {
  const auto device = gpu();
  redrive::Run ends[4];
  for (int i = 0; i < 4; ++i) {
    kernels::Backend& first = i & 1 ? *device : *backend_;
    kernels::Backend& second = i & 2 ? *device : *backend_;
    redrive::Run run = begun("run" + std::to_string(i), first);
    EXPECT_THAT(run.state.device, StartsWith(i & 1 ? "vulkan " : "cpu "));
    EXPECT_EQ(run.state.device, kernels::identity(first));
    train_to(&run, second, 12);
    ends[i] = reopened(run);
    EXPECT_EQ(ends[i].state.device, kernels::identity(second));
    ends[i].state.model->freeze();
  }
  const Scene& scene = ends[0].scene;
  const RayTable rays = make_ray_table(scene.rig[scene.views[0].camera].camera);
  const auto image = [&](int i, kernels::Backend& backend) {
    const redrive::Run& run = ends[i];
    const View& view = run.scene.views[0];
    return run.state.model->render(backend, rays, run.scene.shutter_poses(view),
                                   run.scene.exposure(view));
  };
  const RenderedImage expected = image(0, *backend_);
  for (int i = 0; i < 4; ++i) {
    SCOPED_TRACE(i);
    const RenderedImage on_cpu = image(i, *backend_), on_gpu = image(i, *device);
    ASSERT_EQ(on_cpu.rgb.size(), on_gpu.rgb.size());
    for (std::size_t k = 0; k < on_cpu.rgb.size(); ++k) {
      ASSERT_NEAR(on_gpu.rgb[k], on_cpu.rgb[k], 2e-3) << "rendered on the other backend";
      ASSERT_NEAR(on_cpu.rgb[k], expected.rgb[k], 0.05) << "trained on the other backend";
    }
  }
}

/// Two processes, which are threads here, each with a device or a processor.
TEST_F(VulkanRuns, RanksTrainTogether) {
  const auto trained = [&](const std::string& name, bool first_on_gpu, bool second_on_gpu) {
    std::vector<redrive::Run> runs;
    for (const char* rank : {"0", "1"}) runs.push_back(splat_run(name + rank, 12));
    run_processes(2, [&](int rank, ProcessGroup& processes) {
      redrive::Run& run = runs[static_cast<std::size_t>(rank)];
      ThreadPool pool(1);
      const auto backend =
          (rank == 0 ? first_on_gpu : second_on_gpu) ? gpu() : processor_backend(1);
      const TrainingData data = load_training_data(run, pool);
      const std::atomic<bool> never{false};
      train(&run, data, *backend, never, nullptr, &processes);
    });
    return runs;
  };
  const std::vector<redrive::Run> gpus = trained("gpus", true, true),
                                  processors = trained("processors", false, false);
  const auto numbers = [](const redrive::Run& run) {
    const auto span = run.state.model->parameters.span();
    return std::vector<float>(span.begin(), span.end());
  };
  EXPECT_EQ(numbers(gpus[0]), numbers(gpus[1]));
  EXPECT_NE(numbers(gpus[0]), numbers(processors[0]));
  const RayTable rays = make_ray_table(gpus[0].scene.rig[0].camera);
  const auto image = [&](const redrive::Run& run) {
    run.state.model->freeze();
    return run.state.model->render(*backend_, rays, run.scene.shutter_poses(run.scene.views[0]),
                                   run.scene.exposure(run.scene.views[0]));
  };
  const RenderedImage on_gpus = image(gpus[0]), on_processors = image(processors[0]);
  for (std::size_t k = 0; k < on_gpus.rgb.size(); ++k)
    ASSERT_NEAR(on_gpus.rgb[k], on_processors.rgb[k], 0.05);
  try {
    trained("mixed", true, false);
    ADD_FAILURE() << "ranks on a GPU and on a processor drift apart";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("GPUs of one model and driver"));
  }
}

TEST_F(VulkanRuns, MemoryIsEstimated) {
  WrappedApi api;
  const auto device = gpu();
  redrive::Run run = splat_run("run", 12);
  const std::uint64_t estimate = run.state.model->device_bytes(*device);
  train_to(&run, *device, 12);
  EXPECT_GE(estimate, api.most_device_bytes);
  EXPECT_LT(estimate, 3 * api.most_device_bytes) << "images are smaller than a window";
  EXPECT_GT(device->device_memory(), std::uint64_t{1} << 28);
  EXPECT_EQ(run.state.model->device_bytes(*backend_), 0u);
}

}  // namespace
}  // namespace redrive
