// SPDX-License-Identifier: Apache-2.0
// Sums from which the scores of an image pair follow.
#pragma once

#include <cstdint>

namespace redrive::kernels {

/// Adds up a part of an image: errors of its pixels that count, and SSIM, in each channel, of the
/// windows around such pixels at least kSsimRadius from the border.
struct ScoreSums {
  double luma_squares = 0, squares[3] = {0, 0, 0}, ssim = 0, flip = 0;
  std::int64_t pixels = 0, windows = 0;
};

}  // namespace redrive::kernels
