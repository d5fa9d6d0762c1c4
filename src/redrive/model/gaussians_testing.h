// SPDX-License-Identifier: Apache-2.0
// Gaussians for the tests of file formats.
#pragma once

#include <random>
#include <vector>

#include "redrive/edit/actor_body.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Blocks of n Gaussians of all kinds, the same each time. extent_m: deviation of the positions.
inline std::vector<float> gaussians_of_test(std::size_t n, float extent_m) {
  std::mt19937 random(7);
  std::normal_distribution<float> normal;
  std::vector<float> numbers(gaussian_blocks(n) * kBlockSize);
  for (std::size_t i = 0; i < n; ++i) {
    const auto set = [&](int row, int count, float middle, float spread) {
      for (int k = 0; k < count; ++k)
        numbers[gaussian_slot(i, row + k)] = middle + spread * normal(random);
    };
    set(kPositionRow, 3, 0, extent_m);
    set(kLogScaleRow, 3, -3, 1);
    set(kQuaternionRow, 4, 0, 1);
    set(kOpacityRow, 1, 0, 2);
    set(kColourRow, 3, 0.5f, 0.2f);
    set(kHarmonicsRow, 9, 0, 0.1f);
  }
  return numbers;
}

}  // namespace redrive
