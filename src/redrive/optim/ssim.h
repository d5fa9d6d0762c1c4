// SPDX-License-Identifier: Apache-2.0
// SSIM of one window of one channel (Wang et al., 2004) as scikit-image computes it with
// gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1 (11x11 window, K1 =
// 0.01, K2 = 0.03). In [-1, 1], 1 for equal windows; symmetric.
#pragma once

#include <array>
#include <cmath>

namespace redrive {

constexpr int kSsimRadius = 5;  // truncate 3.5: int(3.5 * 1.5 + 0.5)
constexpr int kSsimTaps = 2 * kSsimRadius + 1;
using SsimTaps = std::array<double, kSsimTaps>;

inline SsimTaps ssim_taps() {
  constexpr double kSigma = 1.5;
  SsimTaps taps;
  double sum = 0;
  for (int i = 0; i < kSsimTaps; ++i)
    sum += taps[i] = std::exp(-0.5 * (i - kSsimRadius) * (i - kSsimRadius) / (kSigma * kSigma));
  for (double& tap : taps) tap /= sum;
  return taps;
}

/// Weighted means of x, y, x^2, y^2 and x y over a window, or over one of its columns; values in
/// [0, 1].
struct SsimMoments {
  double x = 0, y = 0, xx = 0, yy = 0, xy = 0;

  void add(double tap, double value_x, double value_y) {
    x += tap * value_x;
    y += tap * value_y;
    xx += tap * value_x * value_x;
    yy += tap * value_y * value_y;
    xy += tap * value_x * value_y;
  }
  void add(double tap, const SsimMoments& column) {
    x += tap * column.x;
    y += tap * column.y;
    xx += tap * column.xx;
    yy += tap * column.yy;
    xy += tap * column.xy;
  }
};

inline double ssim_from_moments(const SsimMoments& mean) {
  constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03;  // (K data_range)^2
  const double var_x = mean.xx - mean.x * mean.x, var_y = mean.yy - mean.y * mean.y,
               cov = mean.xy - mean.x * mean.y;
  return (2 * mean.x * mean.y + kC1) * (2 * cov + kC2) /
         ((mean.x * mean.x + mean.y * mean.y + kC1) * (var_x + var_y + kC2));
}

}  // namespace redrive
