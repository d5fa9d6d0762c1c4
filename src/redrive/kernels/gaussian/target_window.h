// SPDX-License-Identifier: Apache-2.0
// Windows of ground-truth images as planes, for the loss of an image.
#pragma once

#include <algorithm>

#include "redrive/kernels/gaussian/pixel_gains.h"

namespace redrive::kernels {

/// Sums over the pixels of a target that are not masked.
struct TargetSums {
  double pixels = 0, sum[3] = {0, 0, 0}, squares[3] = {0, 0, 0};

  void add(const TargetSums& row) {
    pixels += row.pixels;
    for (int c = 0; c < 3; ++c) {
      sum[c] += row.sum[c];
      squares[c] += row.squares[c];
    }
  }
  void finish(ImageLossOutput* out) const {
    out->pixels = pixels;
    const double n = std::max(pixels, 1.0);
    for (int c = 0; c < 3; ++c)
      out->colour_variance += std::max(0.0, squares[c] / n - sum[c] / n * (sum[c] / n)) / 3;
  }
};

/// Writes row y of the target's three planes and of its mask, 0 in the padding, and of the planes
/// of gains. Adds to the row's patches.
inline TargetSums convert_target_row(const ImageLossInput& input, int y, float* target, float* mask,
                                     float* gains, PatchBrightness* patches) {
  const TargetWindow& from = input.target;
  const std::size_t plane = input.size.plane(),
                    row = static_cast<std::size_t>(y) * input.size.stride,
                    first = static_cast<std::size_t>(from.y + y) * from.width + from.x;
  TargetSums sums;
  for (int x = 0; x < input.size.stride; ++x) {
    const std::size_t to = row + x, pixel = first + x;
    const bool inside = x < input.size.width;
    const bool used = inside && (from.used.empty() || from.used[pixel] != 0);
    mask[to] = used ? 1.0f : 0.0f;
    const float through =
        !inside || from.alpha.empty() ? 0.0f : 1.0f - from.alpha[pixel] * (1.0f / 255);
    for (int c = 0; c < 3; ++c)
      target[c * plane + to] =
          !inside ? 0.0f
                  : from.rgb[3 * pixel + c] * (1.0f / 255) + through * from.background_change[c];
  }
  for (int c = 0; c < 3; ++c) {
    const std::size_t at = c * plane + row;
    write_gains(input.gains, part_of(from), y, c,
                {gains + at, static_cast<std::size_t>(input.size.stride)});
    float sum = 0, squares = 0;
    for (int first_x = 0; first_x < input.size.stride; first_x += kPatchSide) {
      float pixels = 0, bright = 0, rendered = 0;
      for (int x = first_x; x < first_x + kPatchSide; ++x) {
        const float m = mask[row + x], t = target[at + x] * m, counts = t < kSaturated ? m : 0.0f;
        sum += t;
        squares += t * t;
        pixels += counts;
        bright += counts * t;
        rendered += counts * gains[at + x] * input.rgb[at + x];
      }
      PatchBrightness& patch = patches[first_x / kPatchSide];
      patch.pixels[c] += pixels;
      patch.target[c] += bright;
      patch.rendered[c] += rendered;
    }
    sums.sum[c] = static_cast<double>(sum);
    sums.squares[c] = static_cast<double>(squares);
  }
  for (int x = 0; x < input.size.width; ++x) sums.pixels += static_cast<double>(mask[row + x]);
  return sums;
}

}  // namespace redrive::kernels
