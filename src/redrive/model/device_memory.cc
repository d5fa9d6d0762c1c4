// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/device_memory.h"

#include <utility>

namespace redrive {
namespace {

/// Rays of which nobody asks where they go, with all that a batch may have.
RayBatch make_counting_batch(int n, bool refines) {
  RayBatch batch;
  batch.n = n;
  batch.refines = refines;
  const std::size_t rays = n;
  batch.origin.resize(3 * rays);
  batch.direction.resize(3 * rays);
  batch.target.resize(3 * rays);
  batch.pixel_angle.resize(rays);
  batch.exposure.resize(rays);
  batch.weight.resize(rays);
  return batch;
}

/// The parameters as if no backend kept them, until this goes.
class Unkept {
 public:
  explicit Unkept(const Buffer<float>& numbers)
      : numbers_(numbers), kept_(std::exchange(numbers.resident, nullptr)) {}
  ~Unkept() { numbers_.resident = std::move(kept_); }
  Unkept(const Unkept&) = delete;
  Unkept& operator=(const Unkept&) = delete;

 private:
  const Buffer<float>& numbers_;
  std::shared_ptr<void> kept_;
};

}  // namespace

std::optional<std::uint64_t> count_device_bytes(const kernels::Backend& backend, const Model& model,
                                                const DeviceWork& work) {
  kernels::MemoryCount count;
  const auto counting = backend.counting(&count);
  if (!counting) return std::nullopt;
  const Unkept unkept(model.parameters);
  Buffer<float> gradients(work.step_rays > 0 ? model.size() : 0);
  std::shared_ptr<void> moments[2];
  if (work.trains) {
    kernels::make_resident(*counting, gradients);
    for (auto& moment : moments) moment = counting->make_resident(gradients.span());
  }
  Workspace workspace;
  // Which places of the workspace a batch takes, depends on whether some of its rays are empty;
  // each keeps what it once had.
  for (const bool all_active : {true, false, true}) {
    count.all_active = all_active;
    if (work.step_rays > 0)
      model.gradients(*counting, make_counting_batch(work.step_rays, work.refines), 0, 0, gradients,
                      &workspace);
    if (work.lidar_rays > 0) {
      RayBatch lidar = make_counting_batch(work.lidar_rays, false);
      lidar.range_m.resize(work.lidar_rays);
      model.range_gradients(*counting, lidar, 0, 0, gradients, &workspace);
    }
    if (work.tile_rays > 0) {
      RayBatch tile = make_counting_batch(work.tile_rays, false);
      for (int ray = 0; ray <= work.tile_rays; ++ray) tile.group.push_back(ray);
      std::vector<float> picture(5 * static_cast<std::size_t>(work.tile_rays));
      const std::span<float> all(picture);
      const std::size_t n = work.tile_rays;
      model.render(*counting, tile, {all.first(3 * n), all.subspan(3 * n, n), all.last(n), {}},
                   &workspace);
    }
    if (work.scored_width > 0) {
      const std::size_t n = static_cast<std::size_t>(work.scored_width) * work.scored_height;
      const std::vector<float> rgb(3 * n);
      const std::vector<std::uint8_t> truth(3 * n), mask(n);
      counting->score({work.scored_width, work.scored_height, rgb, truth, mask});
    }
  }
  return count.most;
}

}  // namespace redrive
