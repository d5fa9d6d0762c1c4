// SPDX-License-Identifier: Apache-2.0
// The hash grids' part of GridKernels (grid_kernels.h). Only for files with ISA flags
// (simd/vector.h).
#pragma once

#include "redrive/kernels/cpu/simd/vector.h"
#include "redrive/kernels/grid/cpu/grid_kernels.h"

namespace redrive::kernels::REDRIVE_ISA {

void encode(int features, const GridLevel& level, const GridPoints& points, float* out);
void encode_backward(int features, const GridLevel& level, const GridPoints& points,
                     const float* d_out, float* d_rows, float* d_position);
void density(const GridLevel* levels, int n_levels, float scale, const GridPoints& points,
             float* density);

}  // namespace redrive::kernels::REDRIVE_ISA
