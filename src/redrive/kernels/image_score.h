// SPDX-License-Identifier: Apache-2.0
// Backend::score for one pixel or window, by the scalar functions of optim/ssim.h and optim/flip.h.
// The host runs them in loops (host_image_score.h), devices in kernels
// (device/device_image_score.h). Both images are stored as planes [2, 4, height, width]: red,
// green, blue (black where masked) and one for FLIP's luminance. FLIP overwrites the colours by its
// opponent channels.
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

inline std::size_t pixel_count_of(const ImagePair& images) {
  return static_cast<std::size_t>(images.width) * static_cast<std::size_t>(images.height);
}

inline void check_image_pair(const ImagePair& images) {
  REDRIVE_CHECK_OP(images.width, >=, 1);
  REDRIVE_CHECK_OP(images.height, >=, 1);
  const std::size_t pixels = pixel_count_of(images);
  REDRIVE_CHECK_OP(images.rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(images.ground_truth.size(), ==, 3 * pixels);
  if (!images.mask.empty()) REDRIVE_CHECK_OP(images.mask.size(), ==, pixels);
}

REDRIVE_HD inline bool counts(std::span<const std::uint8_t> mask, std::size_t pixel) {
  return mask.empty() || mask[pixel] != 0;
}

REDRIVE_HD inline void fill_planes_of_pixel(const ImagePair& images, std::size_t pixel,
                                            std::span<float> planes) {
  const std::size_t n = planes.size() / (2 * kImagePlanes);
  const bool used = counts(images.mask, pixel);
  for (std::size_t c = 0; c < 3; ++c) {
    planes[c * n + pixel] = used ? images.rgb[3 * pixel + c] : 0.0f;
    planes[(kImagePlanes + c) * n + pixel] =
        used ? static_cast<float>(images.ground_truth[3 * pixel + c]) / 255.0f : 0.0f;
  }
}

/// Returns the squared error of channel at / n of pixel at % n.
REDRIVE_HD inline double squared_error_at(std::span<const float> planes, std::size_t at) {
  const double error = static_cast<double>(planes[at]) - planes[planes.size() / 2 + at];
  return error * error;
}

/// Returns the number of windows along a row or column of `size` pixels.
inline std::size_t window_count(int size) {
  return static_cast<std::size_t>(std::max(0, size - 2 * kSsimRadius));
}

/// Returns the weighted moments of a window's column that begins at index `at`.
REDRIVE_HD inline SsimMoments ssim_column(const SsimTaps& taps, std::span<const float> planes,
                                          std::size_t at, std::size_t width) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i, at += width)
    means.add(taps[i], planes[at], planes[planes.size() / 2 + at]);
  return means;
}

/// Returns the SSIM of the window of columns[0], columns[1], ...
REDRIVE_HD inline double ssim_window(const SsimTaps& taps, const SsimMoments* columns) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i) means.add(taps[i], columns[i]);
  return ssim_from_moments(means);
}

/// Converts a pixel of one image's planes to opponent colours and luminance.
REDRIVE_HD inline void opponent_colour_of_pixel(std::span<float> planes, std::size_t pixel) {
  const std::size_t n = planes.size() / kImagePlanes;
  const FlipColour opponent =
      flip_opponent({planes[pixel], planes[n + pixel], planes[2 * n + pixel]});
  for (std::size_t c = 0; c < 3; ++c) planes[c * n + pixel] = opponent[c];
  planes[3 * n + pixel] = flip_luminance(opponent);
}

/// Sums over the pixels or windows that count.
struct ScoreSums {
  double squares = 0, ssim = 0, flip = 0;
};
inline ImageScore score_from_sums(const ImagePair& images, const ScoreSums& sums) {
  std::size_t pixels = 0, windows = 0;
  for (int y = 0; y < images.height; ++y)
    for (int x = 0; x < images.width; ++x) {
      if (!counts(images.mask, static_cast<std::size_t>(y) * images.width + x)) continue;
      ++pixels;
      windows += std::min({x, y, images.width - 1 - x, images.height - 1 - y}) >= kSsimRadius;
    }
  const auto mean = [](double sum, std::size_t count) {
    return count > 0 ? sum / static_cast<double>(count) : std::numeric_limits<double>::quiet_NaN();
  };
  return {-10 * std::log10(mean(sums.squares, 3 * pixels)), mean(sums.ssim, 3 * windows),
          mean(sums.flip, pixels)};
}

}  // namespace redrive::kernels
