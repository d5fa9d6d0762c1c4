// SPDX-License-Identifier: Apache-2.0
// Lanes of blocks of Gaussians (field/gaussian.h) that hold none.
#pragma once

#include "redrive/field/gaussian.h"

namespace redrive {

constexpr float kUnusedOpacity = -20;  ///< logit of unused lanes; no Gaussian's

/// Clears lanes [begin, end).
inline void clear_unused(std::size_t begin, std::size_t end, float* numbers) {
  for (std::size_t i = begin; i < end; ++i) {
    for (int row = 0; row < kGaussianRows; ++row) numbers[gaussian_slot(i, row)] = 0;
    numbers[gaussian_slot(i, kQuaternionRow)] = 1;
    numbers[gaussian_slot(i, kOpacityRow)] = kUnusedOpacity;
    numbers[gaussian_slot(i, kDistanceRow)] = 1;
  }
}

}  // namespace redrive
