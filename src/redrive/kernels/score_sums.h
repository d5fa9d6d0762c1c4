// SPDX-License-Identifier: Apache-2.0
// What an image pair's scores are made of.
#pragma once

#include <cstdint>

namespace redrive::kernels {

/// Errors of the pixels that count in a part of an image, and SSIM of the windows around those that
/// are at least kSsimRadius from the border, in each channel, added up.
struct ScoreSums {
  double luma_squares = 0, squares[3] = {0, 0, 0}, ssim = 0, flip = 0;
  std::int64_t pixels = 0, windows = 0;
};

}  // namespace redrive::kernels
