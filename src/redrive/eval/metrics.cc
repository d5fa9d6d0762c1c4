// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/metrics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kRadius = 5;  // truncate 3.5: int(3.5 * 1.5 + 0.5)
constexpr int kTaps = 2 * kRadius + 1;
constexpr double kSigma = 1.5;
constexpr double kC1 = 0.01 * 0.01;  // (K1 data_range)^2
constexpr double kC2 = 0.03 * 0.03;

std::array<double, kTaps> gaussian() {
  std::array<double, kTaps> taps;
  double sum = 0;
  for (int i = 0; i < kTaps; ++i) sum += taps[i] = std::exp(-0.5 * (i - kRadius) * (i - kRadius) / (kSigma * kSigma));
  for (double& tap : taps) tap /= sum;
  return taps;
}

void check_sizes(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask,
                 int width, int height) {
  const std::size_t pixels = static_cast<std::size_t>(width) * height;
  REDRIVE_CHECK_OP(rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(truth.size(), ==, 3 * pixels);
  REDRIVE_CHECK(mask.empty() || mask.size() == pixels);
}

/// The five window means that SSIM needs: of x, y, x^2, y^2 and x y.
constexpr int kMoments = 5;
using Moments = std::array<double, kMoments>;

double ssim_of(const Moments& m) {
  const double mean_x = m[0], mean_y = m[1];
  const double var_x = m[2] - mean_x * mean_x, var_y = m[3] - mean_y * mean_y, cov = m[4] - mean_x * mean_y;
  return (2 * mean_x * mean_y + kC1) * (2 * cov + kC2) /
         ((mean_x * mean_x + mean_y * mean_y + kC1) * (var_x + var_y + kC2));
}

}  // namespace

double psnr_db(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
               int height) {
  check_sizes(rgb, truth, mask, width, height);
  double sum = 0;
  std::size_t values = 0;
  for (std::size_t i = 0; i < rgb.size(); ++i) {
    if (!mask.empty() && mask[i / 3] == 0) continue;
    const double error = static_cast<double>(rgb[i]) - truth[i];
    sum += error * error;
    ++values;
  }
  if (values == 0) return std::numeric_limits<double>::quiet_NaN();
  return -10 * std::log10(sum / static_cast<double>(values));
}

double ssim(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
            int height) {
  check_sizes(rgb, truth, mask, width, height);
  static const std::array<double, kTaps> taps = gaussian();
  const auto value = [&](std::span<const float> image, std::size_t pixel, int channel) {
    return mask.empty() || mask[pixel] != 0 ? static_cast<double>(image[3 * pixel + channel]) : 0.0;
  };

  double sum = 0;
  std::size_t windows = 0;
  std::vector<Moments> columns(width);  // window means down the columns of one row of windows
  for (int channel = 0; channel < 3; ++channel)
    for (int y = kRadius; y + kRadius < height; ++y) {
      std::fill(columns.begin(), columns.end(), Moments{});
      for (int dy = 0; dy < kTaps; ++dy)
        for (int x = 0; x < width; ++x) {
          const std::size_t pixel = static_cast<std::size_t>(y + dy - kRadius) * width + x;
          const double a = value(rgb, pixel, channel), b = value(truth, pixel, channel), tap = taps[dy];
          Moments& column = columns[x];
          column[0] += tap * a;
          column[1] += tap * b;
          column[2] += tap * a * a;
          column[3] += tap * b * b;
          column[4] += tap * a * b;
        }
      for (int x = kRadius; x + kRadius < width; ++x) {
        if (!mask.empty() && mask[static_cast<std::size_t>(y) * width + x] == 0) continue;
        Moments window{};
        for (int dx = 0; dx < kTaps; ++dx)
          for (int m = 0; m < kMoments; ++m) window[m] += taps[dx] * columns[x + dx - kRadius][m];
        sum += ssim_of(window);
        ++windows;
      }
    }
  return windows == 0 ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(windows);
}

}  // namespace redrive
