// SPDX-License-Identifier: Apache-2.0
// PSNR and SSIM on [0, 1], over the pixels where mask is not 0.
#pragma once

#include <cstdint>
#include <span>

namespace redrive {

/// 10 log10(1 / MSE) over all three channels; +infinity for equal images, NaN where the mask leaves nothing.
/// rgb [height, width, 3], mask [height, width] or empty.
double psnr_db(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
               int height);

/// Wang et al. 2004 as scikit-image computes it with gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
/// data_range=1 (11x11 window, K1 0.01, K2 0.03), mean over channels and the pixels at least 5 from the border whose mask
/// is set. Masked pixels that a window reaches count as 0 in both images. In [-1, 1], 1 for equal images; NaN where no
/// pixel is left. Symmetric.
double ssim(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
            int height);

}  // namespace redrive
