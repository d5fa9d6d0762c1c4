// SPDX-License-Identifier: Apache-2.0
// Training and rendering on a device that holds parameters, moments, gradients and the workspace in
// its own memory. The host's copy of a stage's output is NaN until it is downloaded
// (kernels/device/loop_device.h), so that a missing download or upload shows.
#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/model/tiny_grid_model_testing.h"
#include "redrive/train/step.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// A batch with exposures and pose gradients.
RayBatch batch_for_device(int n, std::uint64_t step) {
  RayBatch batch;
  batch.n = n;
  batch.refines = true;
  for (int i = 0; i < 3 * n; ++i) {
    batch.origin.push_back(0);
    batch.target.push_back(static_cast<float>(0.5 + 0.5 * uniform(70 + step, i)));
    batch.direction.push_back(i < n ? 0.8f : i < 2 * n ? 0.6f : 0.0f);
  }
  batch.pixel_angle.assign(n, 0.02f);
  for (int ray = 0; ray < n; ++ray)
    batch.exposure.push_back({ray % 2, 0.1f * static_cast<float>(ray)});
  return batch;
}

/// Compares steps with resident buffers to steps that upload everything each time. The third step
/// is not finite.
void expect_that_keeping_changes_nothing(const std::function<TrainState()>& fresh) {
  const auto keeping = kernels::make_loop_backend();
  Interference nothing;
  InterferingBackend copying(*keeping, &nothing);  // forwards the stages only
  TrainState kept = fresh(), copied = fresh();
  StepBuffers of_kept, of_copied;
  RayBatch lidar = batch_for_device(5, 9);
  lidar.range_m.assign(5, 3.0f);
  for (int step = 0; step < 4; ++step) {
    RayBatch batch = batch_for_device(24, step);
    if (step == 2) batch.target[5] = std::numeric_limits<float>::quiet_NaN();
    const BatchResult a = train_step(*keeping, batch, 1e-2, &kept, &of_kept, &lidar),
                      b = train_step(copying, batch, 1e-2, &copied, &of_copied, &lidar);
    EXPECT_EQ(a.finite, step != 2);
    EXPECT_EQ(b.finite, step != 2);
    EXPECT_EQ(a.loss_of("lidar"), b.loss_of("lidar"));
    EXPECT_EQ(a.opacity, b.opacity);
    if (step == 2) continue;
    EXPECT_EQ(a.loss, b.loss) << step;
    EXPECT_TRUE(bit_equal(a.d_origin, b.d_origin));
    EXPECT_TRUE(bit_equal(a.d_direction, b.d_direction));
  }
  EXPECT_TRUE(std::isnan(kept.adam.first_moment[0])) << "on the host before the download";
  for (const Buffer<float>* numbers :
       {&kept.model->parameters, &kept.adam.first_moment, &kept.adam.second_moment})
    keeping->download(*numbers);
  EXPECT_TRUE(same_weights(kept, copied));
  EXPECT_FALSE(same_weights(kept, fresh()));
}

TrainState grid_for_device() {
  auto model = std::make_unique<GridModel>();
  make_tiny(*model);
  return initial_state(std::move(model), 3);
}

/// A batch with mostly empty rays: the field is evaluated on a few.
TrainState empty_grid_for_device() {
  TrainState state = grid_for_device();
  for (const ModelTensor& tensor : state.model->tensors())
    if (tensor.name == "proposal")
      std::fill_n(&state.model->parameters[tensor.offset], tensor.shape[0], -30.0f);
  return state;
}

TEST(TrainStepOnADevice, OfAGrid) { expect_that_keeping_changes_nothing(grid_for_device); }

TEST(TrainStepOnADevice, OfAGridWithEmptyRays) {
  expect_that_keeping_changes_nothing(empty_grid_for_device);
}

TEST(TrainStepOnADevice, OfAGridOnABackground) {
  expect_that_keeping_changes_nothing([] {
    TrainState state = grid_for_device();
    dynamic_cast<GridModel&>(*state.model).sky.n_levels = 0;
    return initial_state(std::move(state.model), 3);
  });
}

TrainState nerf_for_device() {
  auto model = std::make_unique<NerfModel>();
  model->config = {32, 3, 2};
  model->samples = 6;
  model->fine_samples = 4;
  model->unit_from_world = {{0, 0, 0}, 0.2f};
  return initial_state(std::move(model), 3);
}

TEST(TrainStepOnADevice, OfANerf) { expect_that_keeping_changes_nothing(nerf_for_device); }

/// Returns the bytes of a batch as the stages of --method grid read it.
std::size_t bytes_of_device(const RayBatch& batch) {
  std::size_t floats = 0;
  for (const std::vector<float>* numbers :
       {&batch.origin, &batch.direction, &batch.pixel_angle, &batch.target, &batch.background,
        &batch.weight, &batch.range_m})
    floats += numbers->size();
  return floats * sizeof(float) + batch.exposure.size() * sizeof(Exposure);
}

TEST(TrainStepOnADevice, UploadsTheBatchAndDownloadsAFewNumbers) {
  for (const bool empty : {false, true})
    for (const bool refines : {false, true}) {
      kernels::TransferCounts copies;
      const auto backend = kernels::make_loop_backend(&copies);
      TrainState state = empty ? empty_grid_for_device() : grid_for_device();
      StepBuffers buffers;
      RayBatch batch = batch_for_device(24, 0), lidar = batch_for_device(5, 9);
      batch.refines = refines;
      batch.weight.assign(24, 0.5f);
      lidar.target.clear();
      lidar.exposure.clear();
      lidar.range_m.assign(5, 3.0f);
      StepResult result;
      for (int again = 0; again < 2; ++again) {  // the first one's uploads stay resident
        copies = {};
        state.step = 0;
        result = train_step(*backend, batch, 0, &state, &buffers, &lidar);
      }
      EXPECT_TRUE(result.finite);
      EXPECT_EQ(result.active_rays < 24, empty);
      EXPECT_EQ(copies.to_device, bytes_of_device(batch) + bytes_of_device(lidar));
      const std::size_t of_rays = 24 * (refines ? 3 + 3 : 0) * sizeof(float);
      EXPECT_EQ(copies.to_host, of_rays + sizeof(StepSums) + sizeof(std::uint32_t))
          << "derivatives of origins and directions, losses, the number of active rays";
      EXPECT_EQ(copies.waits, 2u + (refines ? 2 : 0));
    }
}

TEST(TrainStepOnADevice, UploadsTheBatchOfANerfAndDownloadsAFewNumbers) {
  kernels::TransferCounts copies;
  const auto backend = kernels::make_loop_backend(&copies);
  TrainState state = nerf_for_device();
  StepBuffers buffers;
  const RayBatch batch = batch_for_device(24, 0);
  for (int again = 0; again < 2; ++again) {
    copies = {};
    EXPECT_TRUE(train_step(*backend, batch, 0, &state, &buffers).finite);
  }
  EXPECT_EQ(copies.to_device, 3 * 72 * sizeof(float)) << "origins, directions, colours";
  EXPECT_EQ(copies.to_host, 2 * 72 * sizeof(float) + sizeof(StepSums))
      << "derivatives of origins and directions, losses";
  EXPECT_EQ(copies.waits, 2u + 1);
}

struct PictureOfDevice {
  std::vector<float> rgb, depth, opacity;

  PictureOfDevice(kernels::Backend& backend, const RayModel& model, const RayBatch& batch)
      : rgb(3 * batch.n), depth(batch.n), opacity(batch.n) {
    Workspace workspace;
    for (int again = 0; again < 2; ++again)
      model.render_rays(backend, batch, {rgb, depth, opacity, {}}, &workspace);
  }
};

TEST(RenderOnADevice, IsTheSameWithResidentBuffers) {
  for (const bool empty : {false, true})
    for (const bool grouped : {false, true}) {
      const TrainState kept = empty ? empty_grid_for_device() : grid_for_device(),
                       copied = empty ? empty_grid_for_device() : grid_for_device();
      RayBatch batch = batch_for_device(12, 3);
      if (grouped) batch.group = {0, 4, 7, 12};
      const auto keeping = kernels::make_loop_backend();
      Interference nothing;
      InterferingBackend copying(*keeping, &nothing);
      const PictureOfDevice a(*keeping, ray_model(kept), batch),
          b(copying, ray_model(copied), batch);
      EXPECT_TRUE(bit_equal(a.rgb, b.rgb));
      EXPECT_TRUE(bit_equal(a.depth, b.depth));
      EXPECT_TRUE(bit_equal(a.opacity, b.opacity));
      for (const float value : b.rgb) EXPECT_TRUE(std::isfinite(value));
      for (const float value : b.depth) EXPECT_TRUE(std::isfinite(value));
    }
}

TEST(RenderOnADevice, UploadsRaysAndDownloadsTheImage) {
  for (const bool grid : {false, true})
    for (const bool grouped : {false, true}) {
      kernels::TransferCounts copies;
      const auto backend = kernels::make_loop_backend(&copies);
      const TrainState state = grid ? empty_grid_for_device() : nerf_for_device();
      RayBatch batch = batch_for_device(12, 3);
      batch.target.clear();
      if (grouped) batch.group = {0, 4, 7, 12};
      Workspace workspace;
      std::vector<float> rgb(36), depth(12), opacity(12);
      for (int again = 0; again < 2; ++again) {
        copies = {};
        ray_model(state).render_rays(*backend, batch, {rgb, depth, opacity, {}}, &workspace);
      }
      const std::size_t image = (3 + 1 + 1) * 12 * sizeof(float), number = sizeof(float);
      // Each group's origin, direction and angle, each ray's group.
      const std::size_t of_groups = grouped ? (3 * (3 + 3 + 1) + 12) * number : 0;
      EXPECT_EQ(copies.to_device, grid ? bytes_of_device(batch) + of_groups : 72 * number);
      EXPECT_EQ(copies.to_host, image + (grid ? number : 0)) << "and the number of active rays";
    }
}

class TrainingOnADevice : public TrainingTest {};

// Steps 4 and 8 update the poses of the next batches' rays; the sizes of batches change.
TEST_F(TrainingOnADevice, SavesTheStateOfTheDevice) {
  const auto keeping = kernels::make_loop_backend();
  Interference nothing;
  InterferingBackend copying(*keeping, &nothing);  // gathers on the host
  redrive::Run kept = tiny_grid_run(folder_.path / "kept", folder_.path, tiny_options(10)),
               copied = tiny_grid_run(folder_.path / "copied", folder_.path, tiny_options(10));
  EXPECT_EQ(train(&kept, *keeping, never_), TrainEnd::kFinished);
  EXPECT_EQ(train(&copied, copying, never_), TrainEnd::kFinished);
  EXPECT_EQ(kept.state.step, 10);
  EXPECT_TRUE(same_weights(kept.state, copied.state));
  EXPECT_TRUE(same_weights(load_checkpoint(kept.paths.checkpoint()), copied.state));
  EXPECT_EQ(kept.state.poses.moments.updates, 2);
  EXPECT_EQ(kept.state.poses.corrections.values, copied.state.poses.corrections.values);
  EXPECT_LT(*std::ranges::min_element(kept.state.cell_errors.span()), kInitialError);
}

TEST_F(TrainingOnADevice, IsWatchedByItsColours) {
  const auto keeping = kernels::make_loop_backend();
  Interference nothing;
  InterferingBackend copying(*keeping, &nothing);
  StartWatch watches[2];
  for (const bool keep : {true, false}) {
    redrive::Run run =
        tiny_grid_run(folder_.path / (keep ? "kept" : "copied"), folder_.path, tiny_options(403));
    run.state.step = 399;
    EXPECT_EQ(train(&run, keep ? static_cast<kernels::Backend&>(*keeping) : copying, never_),
              TrainEnd::kFinished);
    watches[keep] = run.state.watch;
  }
  EXPECT_GT(watches[0].late_variance, 0);
  EXPECT_EQ(watches[1], watches[0]);
}

LidarReturns returns_for_device(std::size_t n) {
  LidarReturns returns;
  returns.n = n;
  returns.origin.assign(3 * n, 0.5f);
  returns.direction.assign(3 * n, 0);
  std::fill_n(returns.direction.begin(), n, 1.0f);
  for (std::size_t i = 0; i < n; ++i) {
    returns.range_m.push_back(2 + 0.01f * static_cast<float>(i));
    returns.t_ns.push_back(static_cast<std::int64_t>(1'000'000 * i));
  }
  return returns;
}

/// A training set on a device, with steps on it.
struct Drawn {
  redrive::Run run;
  TrainingData data;
  PixelSampler sampler;
  const LidarReturns returns = returns_for_device(40);
  LidarSampler lidar_sampler{returns, 1};
  TrainingSet set{run.scene, data.images, returns, sampler, &lidar_sampler};
  kernels::TransferCounts copies;
  std::unique_ptr<kernels::Backend> backend = kernels::make_loop_backend(&copies);
  RayBuffers rays;
  StepBuffers buffers;

  explicit Drawn(const std::filesystem::path& folder)
      : run(tiny_grid_run(folder / "run", folder, tiny_options(1))),
        data([this] {
          ThreadPool pool(1);
          return load_training_data(run, pool);
        }()),
        sampler(run.scene, data.images, 1) {
    run.state.cell_errors = Buffer<float>(sampler.cells().size());
    std::ranges::fill(run.state.cell_errors.span(), 0.5f);
    auto& model = dynamic_cast<GridModel&>(*run.state.model);
    model.batch_rays = 24;
    model.error_rays = 0.34;  // 8 of them
    model.max_batch_factor = 1;
    model.lidar_rays = 10;
    place_lidar(0);
  }
  void place_lidar(double translation_m) {
    std::vector<FramePose> frames = run.recording.frames;
    for (FramePose& frame : frames)
      frame.global_from_body.translate(Eigen::Vector3d(translation_m, 0, 0));
    lidar_sampler.update_poses(run.scene.global_from_world, run.recording.frames, frames);
  }
  /// Draws batches of `uniform` + 8 rays and of 10 LiDAR rays.
  void draw(int uniform) {
    copies = {};
    draw_batch(*backend, sampler, uniform, 8, next_step(run.state), &rays);
    draw_lidar_batch(*backend, lidar_sampler, run.state.step, 10, &rays);
  }
};

TEST_F(TrainingOnADevice, UploadsNothingAndDownloadsAFewNumbers) {
  Drawn of(folder_.path);
  const auto step = [&](bool pose_gradients) {
    of.copies = {};
    of.run.state.step = 0;
    StepRequest request = next_step(of.run.state);
    request.pose_gradients = pose_gradients;
    EXPECT_TRUE(train_step(*of.backend, of.set, request, 0, &of.run.state, &of.buffers).finite);
  };
  step(false);
  EXPECT_GT(of.copies.to_device,
            of.data.images[0].rgb.size() + 40 * (7 * sizeof(float) + sizeof(std::int64_t)))
      << "resident buffers";
  for (const bool refines : {false, true}) {
    for (int again = 0; again < 2; ++again) step(refines);  // the first one's uploads stay resident
    EXPECT_EQ(of.copies.to_device, 0u);
    const std::size_t of_rays = 24 * (refines ? 3 + 3 + 3 + 1 : 0) * sizeof(float);
    EXPECT_EQ(of.copies.to_host, of_rays + sizeof(StepSums) + sizeof(std::uint32_t))
        << "derivatives of origins and directions, with the directions and views that these are "
           "of; losses and the like; the number of active rays";
    EXPECT_EQ(of.copies.waits, 2u + (refines ? 4 : 0));
    const auto& rays = static_cast<const RayBuffers&>(*of.buffers.method);
    EXPECT_EQ(std::isnan(rays.batch.direction[0]), !refines) << "on the host before the download";
  }
}

TEST_F(TrainingOnADevice, UploadsPosesAfterTheyChanged) {
  Drawn of(folder_.path);
  of.draw(16);
  const auto origins = [&] {
    kernels::download(*of.backend, of.rays.lidar.origin);
    return of.rays.lidar.origin;
  };
  const std::vector<float> before = origins();
  of.sampler.update_poses();
  of.place_lidar(0.25);
  of.draw(16);
  EXPECT_EQ(of.copies.to_device,
            of.sampler.source().poses.size_bytes() + of.lidar_sampler.source().poses.size_bytes());
  EXPECT_NE(origins(), before);
  of.draw(16);
  EXPECT_EQ(of.copies.to_device, 0u);
}

TEST_F(TrainingOnADevice, GathersBatchesOfAllSizes) {
  Drawn of(folder_.path);
  for (const int even : {16, 100, 40, 99, 300}) {
    of.draw(even);
    RayBatch expected;
    of.sampler.gather(0, even, &expected, {8, std::vector<float>(of.sampler.cells().size(), 0.5f)});
    ASSERT_EQ(of.rays.batch.n, even + 8);
    for (const auto numbers :
         {&RayBatch::origin, &RayBatch::direction, &RayBatch::target, &RayBatch::pixel_angle}) {
      kernels::download(*of.backend, of.rays.batch.*numbers);
      EXPECT_EQ(of.rays.batch.*numbers, expected.*numbers) << even;
    }
    for (const auto numbers : {&RayBatch::view, &RayBatch::cell}) {
      kernels::download(*of.backend, of.rays.batch.*numbers);
      EXPECT_EQ(of.rays.batch.*numbers, expected.*numbers) << even;
    }
  }
}

TEST_F(TrainingOnADevice, ALostDeviceLeavesTheLastCheckpointAndReportsHowToResume) {
  TrainOptions options = tiny_options(12);
  options.checkpoint_every = 4;
  const auto backend = kernels::make_loop_backend();
  redrive::Run whole = tiny_grid_run(folder_.path / "whole", folder_.path, options);
  EXPECT_EQ(train(&whole, *backend, never_), TrainEnd::kFinished);
  // In the first step, later, while downloading a checkpoint.
  std::int64_t last_step = -1;
  for (const std::int64_t launches : {0, 1, 300, 700}) {
    kernels::InjectedFaults faults{.kernel_launches = launches};
    const auto failing = kernels::make_loop_backend(nullptr, true, &faults);
    redrive::Run lost =
        tiny_grid_run(folder_.path / ("lost" + std::to_string(launches)), folder_.path, options);
    try {
      train(&lost, *failing, never_);
      ADD_FAILURE() << "did not fail after " << launches;
    } catch (const DeviceError& error) {
      EXPECT_EQ(error.what(), "step " + std::to_string(lost.state.step) +
                                  ": the GPU failed, computing: injected fault; the last "
                                  "checkpoint stands, go on from it "
                                  "with: redrive resume " +
                                  lost.paths.root.string());
    }
    redrive::Run resumed = reopened(lost);
    EXPECT_EQ(resumed.state.step % 4, 0);
    EXPECT_LE(resumed.state.step, lost.state.step);
    last_step = resumed.state.step;
    EXPECT_EQ(train(&resumed, *backend, never_), TrainEnd::kFinished);
    EXPECT_TRUE(same_weights(resumed.state, whole.state)) << launches;
    EXPECT_EQ(curve(resumed), curve(whole)) << launches;
  }
  EXPECT_GT(last_step, 0) << "resumed from a checkpoint after the first";
}

TEST_F(TrainingOnADevice, AFullDeviceReportsHowToResumeWithLessOrLater) {
  TrainOptions options = tiny_options(12);
  options.checkpoint_every = 4;
  constexpr std::int64_t kEnough = 1 << 30;
  kernels::InjectedFaults room{.allocations = kEnough};
  redrive::Run whole = tiny_grid_run(folder_.path / "whole", folder_.path, options);
  EXPECT_EQ(train(&whole, *kernels::make_loop_backend(nullptr, true, &room), never_),
            TrainEnd::kFinished);
  std::int64_t last_step = -1;
  for (const std::int64_t allocations :
       {std::int64_t{0}, std::int64_t{3}, (kEnough - room.allocations) * 3 / 4}) {
    kernels::InjectedFaults faults{.allocations = allocations};
    const auto full = kernels::make_loop_backend(nullptr, true, &faults);
    redrive::Run run =
        tiny_grid_run(folder_.path / ("full" + std::to_string(allocations)), folder_.path, options);
    try {
      train(&run, *full, never_);
      ADD_FAILURE() << "did not run out of memory with " << allocations;
    } catch (const DeviceMemoryError& error) {
      EXPECT_EQ(error.what(), "step " + std::to_string(run.state.step) +
                                  ": --backend loop: the GPU has no memory left: injected fault; "
                                  "the last checkpoint stands, go on "
                                  "from it with: redrive resume " +
                                  run.paths.root.string());
    }
    redrive::Run resumed = reopened(run);
    last_step = resumed.state.step;
    EXPECT_EQ(train(&resumed, *kernels::make_loop_backend(), never_), TrainEnd::kFinished);
    EXPECT_TRUE(same_weights(resumed.state, whole.state)) << allocations;
  }
  EXPECT_GT(last_step, 0) << "none ran out of memory during training";
}

TEST_F(TrainingOnADevice, TrainsOnAGpuAsOnTheProcessor) {
  if (const auto obstacle = kernels::cuda_obstacle()) GTEST_SKIP() << "cuda: " << *obstacle;
  const auto gpu = kernels::make_cuda_backend(2);
  redrive::Run run = tiny_grid_run(folder_.path / "gpu", folder_.path, tiny_options(100)),
               same = tiny_grid_run(folder_.path / "processor", folder_.path, tiny_options(100));
  EXPECT_EQ(train(&run, *gpu, never_), TrainEnd::kFinished);
  EXPECT_EQ(train(&same, *backend_, never_), TrainEnd::kFinished);
  const auto rows = read_metrics(run.paths), expected = read_metrics(same.paths);
  ASSERT_EQ(rows.size(), expected.size());
  EXPECT_GT(rows.back().psnr_db, rows.front().psnr_db);
  // Equal up to rounding, which grows from step to step.
  EXPECT_NEAR(rows.front().psnr_db, expected.front().psnr_db, 0.1);
  EXPECT_NEAR(rows.back().psnr_db, expected.back().psnr_db, 1);
  EXPECT_EQ(load_checkpoint(run.paths.checkpoint()).step, 100);
}

}  // namespace
}  // namespace redrive
