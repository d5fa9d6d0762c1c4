// SPDX-License-Identifier: Apache-2.0
// What a model takes of a backend's own memory, before anything is computed there.
#pragma once

#include <cstdint>
#include <optional>

#include "redrive/model/model.h"

namespace redrive {

/// What is asked of a model, and of the backend with its pictures: rays of the largest batch of
/// each kind, the largest picture that is scored; 0: none.
struct DeviceWork {
  int step_rays = 0, lidar_rays = 0, tile_rays = 0;
  bool refines = false;  ///< RayBatch::refines
  bool trains = false;   ///< gradients and Adam's moments stay there
  int scored_width = 0, scored_height = 0;
};

/// Bytes at the peak, counted by going through all of it without computing
/// (kernels::Backend::counting); nothing where the backend works in the host's memory.
std::optional<std::uint64_t> count_device_bytes(const kernels::Backend& backend, const Model& model,
                                                const DeviceWork& work);

}  // namespace redrive
