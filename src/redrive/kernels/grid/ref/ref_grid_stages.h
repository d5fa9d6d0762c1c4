// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid of the reference backend.
#pragma once

#include <memory>

#include "redrive/kernels/grid/grid_stages.h"

namespace redrive::kernels {

std::unique_ptr<GridStages> make_ref_grid_stages();

}  // namespace redrive::kernels
