// SPDX-License-Identifier: Apache-2.0
// The stages of --method nerf of the reference backend.
#pragma once

#include <memory>

#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {

/// `backend` owns the stages.
std::unique_ptr<NerfStages> make_ref_nerf_stages(Backend& backend);

}  // namespace redrive::kernels
