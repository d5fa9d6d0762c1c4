// SPDX-License-Identifier: Apache-2.0
// Gains of an image's pixels, written out row by row.
#pragma once

#include <algorithm>

#include "redrive/field/shading.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// Writes the gains of channel c along row y of the part, from its first pixel on. Pixels beyond
/// the image have finite values.
inline void write_gains(const PixelGains& gains, const ImagePart& part, int y, int c,
                        std::span<float> row) {
  const float step = 1.0f / static_cast<float>(part.image_width);
  std::ranges::fill(row, gains.colour[c]);
  if (gains.log_shading.empty()) return;
  apply_shading({1, gains.columns, gains.rows}, gains.log_shading, 0, c,
                {(static_cast<float>(part.y + y) + 0.5f) / static_cast<float>(part.image_height),
                 (static_cast<float>(part.x) + 0.5f) * step, step},
                row);
}

/// Returns where a target's window lies.
inline ImagePart part_of(const TargetWindow& target) {
  const std::size_t pixels = target.rgb.size() / 3;
  return {target.x, target.y, target.width, static_cast<int>(pixels / target.width)};
}

}  // namespace redrive::kernels
