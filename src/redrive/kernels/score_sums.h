// SPDX-License-Identifier: Apache-2.0
// What an image pair's scores are made of.
#pragma once

#include <cstdint>

namespace redrive::kernels {

/// Sums over the pixels that count, and over the windows of SSIM around those of them that are at
/// least kSsimRadius from the border, in each channel.
struct ScoreSums {
  double luma_squares = 0, squares[3] = {0, 0, 0}, ssim = 0, flip = 0;
  std::int64_t pixels = 0, windows = 0;
};

}  // namespace redrive::kernels
