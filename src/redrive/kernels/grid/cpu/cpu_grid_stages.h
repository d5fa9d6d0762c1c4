// SPDX-License-Identifier: Apache-2.0
// The cpu backend's stages of --method grid.
#pragma once

#include <memory>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"
#include "redrive/kernels/grid/grid_stages.h"

namespace redrive::kernels {

/// `pool` must outlive the stages.
std::unique_ptr<GridStages> make_cpu_grid_stages(Isa isa, ThreadPool* pool);

}  // namespace redrive::kernels
