// SPDX-License-Identifier: Apache-2.0
// FLIP (Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images", LDR form): how different two pictures look to
// somebody who flips between them. Needs no trained network.
#pragma once

#include <cstdint>
#include <span>

namespace redrive {

/// Pixels per degree of the paper's viewer: a 3840 pixels wide, 0.7 m wide screen, 0.7 m away.
constexpr double kFlipPixelsPerDegree = 3840 * 3.14159265358979323846 / 180;

/// Mean over the pixels where mask is not 0 of the FLIP difference, in [0, 1], 0 for equal pictures; NaN where the mask
/// leaves nothing. rgb [height, width, 3] sRGB in [0, 1] (clamped), mask [height, width] or empty; masked pixels count
/// as black in both where a filter reaches them. Borders are replicated, as the paper does.
double flip(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
            int height);

}  // namespace redrive
