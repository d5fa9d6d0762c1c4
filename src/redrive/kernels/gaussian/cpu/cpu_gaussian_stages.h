// SPDX-License-Identifier: Apache-2.0
// The cpu backend's stages of rasterising Gaussians.
#pragma once

#include <memory>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// `pool` must outlive the stages.
std::unique_ptr<GaussianStages> make_cpu_gaussian_stages(Isa isa, ThreadPool* pool);

}  // namespace redrive::kernels
