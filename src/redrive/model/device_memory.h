// SPDX-License-Identifier: Apache-2.0
// Memory of a device that a model takes, counted before anything is computed there.
#pragma once

#include <cstdint>
#include <optional>

#include "redrive/model/model.h"

namespace redrive {

/// Returns the bytes at the peak of `work`, counted by a rehearsal without computing
/// (kernels::Backend::counting); nothing where the backend works in the host's memory.
std::optional<std::uint64_t> count_device_bytes(const kernels::Backend& backend, const Model& model,
                                                const DeviceWork& work);

}  // namespace redrive
