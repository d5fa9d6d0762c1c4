// SPDX-License-Identifier: Apache-2.0
// Counts the device memory that a model takes, before computing on the device.
#pragma once

#include <cstdint>
#include <optional>

#include "redrive/model/model.h"

namespace redrive {

/// Returns the bytes at the peak of `work`, counted by a dry run
/// (kernels::Backend::counting); nothing where the backend uses host memory.
std::optional<std::uint64_t> count_device_bytes(const kernels::Backend& backend, const Model& model,
                                                const DeviceWork& work);

}  // namespace redrive
