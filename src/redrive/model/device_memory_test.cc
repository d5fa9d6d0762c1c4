// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/device_memory.h"

#include <gtest/gtest.h>

#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/model/nerf_model.h"
#include "redrive/model/tiny_grid_model_testing.h"

namespace redrive {
namespace {

/// Returns rays that look ahead.
RayBatch batch_of(int n, bool refines) {
  RayBatch batch;
  batch.n = n;
  batch.refines = refines;
  batch.origin.assign(3 * n, 0);
  batch.direction.assign(3 * n, 0);
  std::fill_n(batch.direction.begin(), n, 1.0f);
  batch.target.assign(3 * n, 0.5f);
  batch.pixel_angle.assign(n, 0.02f);
  batch.exposure.assign(n, {0, 0.1f});
  batch.weight.assign(n, 1);
  return batch;
}

/// Measures the bytes that the emulated device takes for the same work. It allocates every buffer
/// singly, a GPU suballocates them (kernels/device/arena.h).
std::size_t taken(const RayModel& model, const DeviceWork& work, bool tensor_cores) {
  kernels::TransferCounts copies;
  const auto backend = kernels::make_loop_backend(&copies, tensor_cores);
  Workspace workspace;
  Buffer<float> gradients(model.size());
  std::shared_ptr<void> moments[2];
  if (work.trains) {
    kernels::make_resident(*backend, gradients);
    for (auto& moment : moments) moment = backend->make_resident(gradients.span());
  }
  for (int again = 0; again < 2; ++again) {
    if (work.step_pixels > 0)
      model.gradients(*backend, batch_of(work.step_pixels, work.pose_gradients), 1, again,
                      gradients, &workspace);
    if (work.lidar_rays > 0) {
      RayBatch lidar = batch_of(work.lidar_rays, false);
      lidar.range_m.assign(work.lidar_rays, 2.0f);
      model.range_gradients(*backend, lidar, 1, again, gradients, &workspace);
    }
    if (work.tile_pixels > 0) {
      const std::size_t n = work.tile_pixels;
      std::vector<float> rgb(3 * n), depth(n), opacity(n);
      model.render_rays(*backend, batch_of(work.tile_pixels, false), {rgb, depth, opacity, {}},
                        &workspace);
    }
    if (work.scored_width > 0) {
      const std::size_t n = static_cast<std::size_t>(work.scored_width) * work.scored_height;
      backend->score({work.scored_width, work.scored_height, std::vector<float>(3 * n),
                      std::vector<std::uint8_t>(3 * n), std::vector<std::uint8_t>(n, 1)});
    }
  }
  model.parameters.resident = nullptr;
  return copies.peak_bytes;
}

void expect_what_is_taken(const RayModel& model) {
  for (const bool tensor_cores : {true, false})
    for (const DeviceWork& work :
         {DeviceWork{.step_pixels = 200, .trains = true},
          DeviceWork{.step_pixels = 200, .pose_gradients = true},
          DeviceWork{.step_pixels = 50, .lidar_rays = 300, .trains = true},
          DeviceWork{.tile_pixels = 400},
          DeviceWork{.tile_pixels = 40, .scored_width = 90, .scored_height = 70}}) {
      SCOPED_TRACE(std::to_string(work.step_pixels) + " rays, " + std::to_string(work.lidar_rays) +
                   " of LiDAR, " + std::to_string(work.tile_pixels) + " of a tile, scored " +
                   std::to_string(work.scored_width) + " pixels wide, tensor cores " +
                   std::to_string(tensor_cores));
      const auto backend = kernels::make_loop_backend(nullptr, tensor_cores);
      const auto bytes = count_device_bytes(*backend, model, work);
      const std::size_t real = taken(model, work, tensor_cores);
      ASSERT_TRUE(bytes);
      EXPECT_GE(*bytes, real) << "batches are counted at their largest";
      EXPECT_LE(*bytes, 2 * real) << "outgrown blocks are kept beside larger ones";
      EXPECT_EQ(model.parameters.resident, nullptr);
    }
}

TEST(DeviceMemory, CountsTheBytesOfAGrid) {
  GridModel model;
  make_tiny(model);
  expect_what_is_taken(model);
}

TEST(DeviceMemory, CountsTheBytesOfANerf) {
  NerfModel model;
  model.config = {32, 4, 2};
  model.samples = 5;
  model.fine_samples = 4;
  model.initialize(3);
  expect_what_is_taken(model);
}

TEST(DeviceMemory, CountingKeepsResidentBuffersUnchanged) {
  GridModel model;
  make_tiny(model);
  const auto backend = kernels::make_loop_backend();
  kernels::make_resident(*backend, model.parameters);
  const void* const kept = model.parameters.resident.get();
  const float first = model.parameters[0];
  EXPECT_TRUE(count_device_bytes(*backend, model, {.step_pixels = 10, .tile_pixels = 10}));
  EXPECT_EQ(model.parameters.resident.get(), kept);
  EXPECT_EQ(model.parameters[0], first);
}

TEST(DeviceMemory, CountsNothingOnTheHost) {
  GridModel model;
  make_tiny(model);
  EXPECT_FALSE(count_device_bytes(*kernels::make_ref_backend(), model, {.tile_pixels = 10}));
  EXPECT_FALSE(kernels::make_ref_backend()->free_memory());
}

}  // namespace
}  // namespace redrive
