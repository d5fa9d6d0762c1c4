// SPDX-License-Identifier: Apache-2.0
// Backend::score for one pixel or window, by the scalar functions of optim/ssim.h and optim/flip.h:
// the host runs them in loops (host_image_score.h), devices in kernels
// (device/device_image_score.h). Both images lie in planes [2, 4, height, width]: red, green, blue
// (black where masked) and an unused one; later FLIP's opponent colour channels and the luminance.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#include "redrive/optim/flip.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {

constexpr std::size_t kImagePlanes = 4;

inline std::size_t pixel_count_of(const ImagePair& pictures) {
  return static_cast<std::size_t>(pictures.width) * static_cast<std::size_t>(pictures.height);
}

inline void check_image_pair(const ImagePair& pictures) {
  REDRIVE_CHECK_OP(pictures.width, >=, 1);
  REDRIVE_CHECK_OP(pictures.height, >=, 1);
  const std::size_t pixels = pixel_count_of(pictures);
  REDRIVE_CHECK_OP(pictures.rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(pictures.truth.size(), ==, 3 * pixels);
  if (!pictures.mask.empty()) REDRIVE_CHECK_OP(pictures.mask.size(), ==, pixels);
}

REDRIVE_HD inline bool counts(std::span<const std::uint8_t> mask, std::size_t pixel) {
  return mask.empty() || mask[pixel] != 0;
}

REDRIVE_HD inline void fill_planes_of_pixel(const ImagePair& pictures, std::size_t pixel,
                                            std::span<float> planes) {
  const std::size_t n = planes.size() / (2 * kImagePlanes);
  const bool seen = counts(pictures.mask, pixel);
  for (std::size_t c = 0; c < 3; ++c) {
    planes[c * n + pixel] = seen ? pictures.rgb[3 * pixel + c] : 0.0f;
    planes[(kImagePlanes + c) * n + pixel] =
        seen ? static_cast<float>(pictures.truth[3 * pixel + c]) / 255.0f : 0.0f;
  }
}

/// Of channel at / n of pixel at % n.
REDRIVE_HD inline double squared_error_at(std::span<const float> planes, std::size_t at) {
  const double error = static_cast<double>(planes[at]) - planes[planes.size() / 2 + at];
  return error * error;
}

/// How many windows fit into a row, or a column, of so many pixels.
inline std::size_t window_count(int size) {
  return static_cast<std::size_t>(std::max(0, size - 2 * kSsimRadius));
}

/// Means over a window's column, of which `at` is the uppermost number.
REDRIVE_HD inline SsimMoments ssim_column(const SsimTaps& taps, std::span<const float> planes,
                                          std::size_t at, std::size_t width) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i, at += width)
    means.add(taps[i], planes[at], planes[planes.size() / 2 + at]);
  return means;
}

/// The window of columns[0], columns[1], ...
REDRIVE_HD inline double ssim_window(const SsimTaps& taps, const SsimMoments* columns) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i) means.add(taps[i], columns[i]);
  return ssim_from_moments(means);
}

/// Of one picture's planes.
REDRIVE_HD inline void opponent_colour_of_pixel(std::span<float> picture, std::size_t pixel) {
  const std::size_t n = picture.size() / kImagePlanes;
  const FlipColour opponent =
      flip_opponent({picture[pixel], picture[n + pixel], picture[2 * n + pixel]});
  for (std::size_t c = 0; c < 3; ++c) picture[c * n + pixel] = opponent[c];
  picture[3 * n + pixel] = flip_luminance(opponent);
}

/// Sums over what counts of both pictures.
struct ScoreSums {
  double squares = 0, ssim = 0, flip = 0;
};
inline ImageScore score_from_sums(const ImagePair& pictures, const ScoreSums& sums) {
  std::size_t pixels = 0, windows = 0;
  for (int y = 0; y < pictures.height; ++y)
    for (int x = 0; x < pictures.width; ++x) {
      if (!counts(pictures.mask, static_cast<std::size_t>(y) * pictures.width + x)) continue;
      ++pixels;
      windows += std::min({x, y, pictures.width - 1 - x, pictures.height - 1 - y}) >= kSsimRadius;
    }
  const auto mean = [](double sum, std::size_t count) {
    return count > 0 ? sum / static_cast<double>(count) : std::numeric_limits<double>::quiet_NaN();
  };
  return {-10 * std::log10(mean(sums.squares, 3 * pixels)), mean(sums.ssim, 3 * windows),
          mean(sums.flip, pixels)};
}

}  // namespace redrive::kernels
