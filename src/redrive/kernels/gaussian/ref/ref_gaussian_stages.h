// SPDX-License-Identifier: Apache-2.0
// The stages of rasterising Gaussians of the reference backend.
#pragma once

#include <memory>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

std::unique_ptr<GaussianStages> make_ref_gaussian_stages();

}  // namespace redrive::kernels
