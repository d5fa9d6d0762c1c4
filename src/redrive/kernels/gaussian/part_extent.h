// SPDX-License-Identifier: Apache-2.0
// Pixels that an object has in an image (RasterOptions::parts). It is one part or several.
#pragma once

#include <climits>
#include <cstdint>

namespace redrive::kernels {

struct PartExtent {
  std::uint32_t visible = 0;  ///< pixels that show the part (RasterImage::parts)
  /// Pixels of which the part, alone in the image, would cover more than half, and the columns and
  /// rows that hold them, inclusive.
  std::uint32_t whole = 0;
  int left = INT_MAX, top = INT_MAX, right = INT_MIN, bottom = INT_MIN;
};

}  // namespace redrive::kernels
