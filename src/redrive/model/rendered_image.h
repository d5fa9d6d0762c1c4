// SPDX-License-Identifier: Apache-2.0
// Images and rays that a model renders.
#pragma once

#include <cstdint>
#include <vector>

namespace redrive {

/// An image that a model renders. Pixels outside the valid region of the camera model are black
/// with depth 0, opacity 0 and valid 0.
struct RenderedImage {
  int width = 0, height = 0;
  std::vector<float> rgb;           ///< [height, width, 3] in [0, 1]
  std::vector<float> depth;         ///< [height, width], metres along the ray, median
  std::vector<float> opacity;       ///< [height, width]
  std::vector<std::uint8_t> valid;  ///< [height, width]
};

/// Depth and opacity along single rays.
struct RenderedRays {
  std::vector<float> depth;    ///< [n], metres from the origin along the ray, median
  std::vector<float> opacity;  ///< [n]
};

}  // namespace redrive
