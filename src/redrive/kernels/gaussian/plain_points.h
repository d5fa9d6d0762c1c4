// SPDX-License-Identifier: Apache-2.0
// GaussianStages::project_points in plain numbers.
#pragma once

#include <span>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// In double. pool: null: one thread.
void project_plain_points(const GaussianCamera& camera, std::span<const float> points,
                          ThreadPool* pool, std::span<float> pixels);

}  // namespace redrive::kernels
