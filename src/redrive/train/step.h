// SPDX-License-Identifier: Apache-2.0
// One training step, from rays to Adam.
#pragma once

#include "redrive/rays/lidar_sampler.h"
#include "redrive/rays/ray_table.h"
#include "redrive/train/state.h"

namespace redrive {

/// A batch's vectors, kept where a backend computes.
class DeviceBatch {
 public:
  /// After they have been sized; all that they have room for is kept, so that a larger batch seldom
  /// needs more. The same batch each time.
  void keep(kernels::Backend& backend, RayBatch* batch);

 private:
  struct Room {
    const void* numbers = nullptr;
    std::size_t size = 0;
    std::shared_ptr<void> there;
  };
  Room rooms_[10];
};

/// Working memory of a backend's steps; grows to the largest batch seen.
struct StepBuffers {
  Workspace workspace;
  Buffer<float> gradients;
  DeviceBatch batch, lidar;
  PixelSource pictures;  ///< the samplers', as this backend keeps them
  LidarSource returns;
};

struct StepResult : StepOutput, LossTerms {
  double loss = 0;                   ///< Model::loss
  bool finite = true;                ///< false: the step is not applied
  int rays = 0, error_map_rays = 0;  ///< of the batch
};

/// Which part of each step's rays a backend has: one of `of`, all of a size.
struct Share {
  int rank = 0, of = 1;
};

/// A step has at most so many times the rays that the options say.
constexpr double kMaxBatchFactor = 2;

/// Rays of a step, so that the field is asked about batch_rays of them: TrainState::active_fraction
/// says how many are not empty.
inline int rays_per_step(int batch_rays, double active_fraction) {
  return static_cast<int>(
      batch_rays * (active_fraction * kMaxBatchFactor > 1 ? 1 / active_fraction : kMaxBatchFactor));
}

/// What PixelSampler::gather does from state->rays_drawn on, where the backend computes: the host
/// has of the batch what it fetches, and its sizes. even, error_map_rays: of this share; the even
/// rays of all shares are those that one backend would draw of them. `buffers` must not outlive the
/// batch, and see one sampler.
void gather_batch(kernels::Backend& backend, const PixelSampler& sampler, int even,
                  int error_map_rays, TrainState* state, RayBatch* batch, StepBuffers* buffers,
                  const Share& share = {});

/// The same with what LidarSampler::gather does.
void gather_lidar(kernels::Backend& backend, const LidarSampler& sampler, std::int64_t step, int n,
                  RayBatch* batch, StepBuffers* buffers);

/// lidar: rays with ranges, or null. `state->step` counts on by one and rays_drawn by the even
/// rays; where rays have cells, their errors are taken in. Where the batch refines, its directions
/// and views are fetched. Non-finite loss or gradients: parameters stay as they were.
StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate,
                      TrainState* state, StepBuffers* buffers, const RayBatch* lidar = nullptr);

/// train_step in its parts, for backends that make a step together. Losses and gradients, added to
/// those of the buffers, which are zeros before:
StepResult step_gradients(kernels::Backend& backend, const RayBatch& batch, const TrainState& state,
                          StepBuffers* buffers, const RayBatch* lidar);
/// And what follows from them for the state. cells: of the rays that result.squares is of.
void apply_step(kernels::Backend& backend, const StepResult& result,
                std::span<const std::uint32_t> cells, double learning_rate, TrainState* state,
                StepBuffers* buffers);

}  // namespace redrive
