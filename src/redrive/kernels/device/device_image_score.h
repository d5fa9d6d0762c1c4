// SPDX-License-Identifier: Apache-2.0
// Backend::score on a device: one functor for each step of image_score.h, and filters whose taps
// are kernel arguments.
#pragma once

#include "redrive/kernels/device/stage.h"
#include "redrive/kernels/image_score.h"

namespace redrive::kernels {

struct FillPlanes {
  ImagePair images;
  std::span<float> planes;

  REDRIVE_HD void operator()(std::size_t pixel) const {
    fill_planes_of_pixel(images, pixel, planes);
  }
};

/// i: index into three channels of all pixels.
struct SquaredErrors {
  std::span<const float> planes;

  REDRIVE_HD double operator()(std::size_t i) const { return squared_error_at(planes, i); }
};

/// i: index of a column of windows in a channel, row by row.
struct SsimColumns {
  SsimTaps taps;
  std::span<const float> planes;
  std::size_t first, width;
  std::span<SsimMoments> columns;

  REDRIVE_HD void operator()(std::size_t i) const {
    columns[i] = ssim_column(taps, planes, first + i, width);
  }
};

/// i: index of a window in a channel, row by row.
struct SsimWindows {
  SsimTaps taps;
  std::span<const SsimMoments> columns;
  std::span<const std::uint8_t> mask;
  std::size_t width;

  REDRIVE_HD double operator()(std::size_t i) const {
    const std::size_t across = width - 2 * kSsimRadius, at = i / across * width + i % across;
    return counts(mask, at + kSsimRadius * (width + 1)) ? ssim_window(taps, &columns[at]) : 0;
  }
};

struct OpponentPixels {
  std::span<float> image_planes;  ///< planes of one image

  REDRIVE_HD void operator()(std::size_t pixel) const {
    opponent_colour_of_pixel(image_planes, pixel);
  }
};

/// Filters a line of `size` numbers that are `stride` apart, at index `at`. Repeats the border
/// values beyond its ends.
template <std::size_t n>
REDRIVE_HD float filtered(const std::array<float, n>& taps, const float* line, int at, int size,
                          std::size_t stride) {
  float sum = 0;
  for (int i = 0; i < static_cast<int>(n); ++i) {
    const int from = std::clamp(at + i - static_cast<int>(n / 2), 0, size - 1);
    sum += taps[i] * line[from * stride];
  }
  return sum;
}

/// Filters along x: the terms of each colour channel, and the luminance smoothed and with first and
/// second derivative. rows [7, n].
constexpr std::size_t kFilteredPlanes = FlipFilters::kTerms + 3;
struct FilterRows {
  FlipFilters filters;
  std::span<const float> image_planes;
  int width;
  std::span<float> rows;

  REDRIVE_HD void operator()(std::size_t pixel) const {
    const std::size_t n = image_planes.size() / kImagePlanes;
    const int x = static_cast<int>(pixel % width);
    const auto put = [&](std::size_t to, std::size_t plane, const auto& taps) {
      rows[to * n + pixel] = filtered(taps, &image_planes[plane * n + pixel - x], x, width, 1);
    };
    for (std::size_t t = 0; t < FlipFilters::kTerms; ++t)
      put(t, filters.colour[t].channel, filters.colour[t].taps);
    put(FlipFilters::kTerms, 3, filters.smooth);
    put(FlipFilters::kTerms + 1, 3, filters.first);
    put(FlipFilters::kTerms + 2, 3, filters.second);
  }
};

/// Filters along y and computes FLIP's perceived colours and features.
struct FilterColumns {
  FlipFilters filters;
  std::span<const float> rows;
  int width;
  std::span<FlipPixel> perceived;

  REDRIVE_HD void operator()(std::size_t pixel) const {
    const std::size_t n = perceived.size();
    const int y = static_cast<int>(pixel / width), height = static_cast<int>(n / width);
    const auto get = [&](std::size_t plane, const auto& taps) {
      return filtered(taps, &rows[plane * n + pixel % width], y, height, width);
    };
    std::array<float, FlipFilters::kTerms> colour;
    for (std::size_t t = 0; t < FlipFilters::kTerms; ++t)
      colour[t] = get(t, filters.colour[t].taps);
    constexpr std::size_t kSmooth = FlipFilters::kTerms, kFirst = kSmooth + 1,
                          kSecond = kSmooth + 2;
    perceived[pixel] = {flip_lab(filters, colour),
                        flip_magnitude(get(kFirst, filters.smooth), get(kSmooth, filters.first)),
                        flip_magnitude(get(kSecond, filters.smooth), get(kSmooth, filters.second))};
  }
};

struct FlipDifferences {
  FlipFilters filters;
  std::span<const FlipPixel> a, b;
  std::span<const std::uint8_t> mask;

  REDRIVE_HD double operator()(std::size_t pixel) const {
    return counts(mask, pixel) ? flip_difference(filters, a[pixel], b[pixel]) : 0;
  }
};

template <class Device>
ImageScore score_on_device(Device& device, const ImagePair& images) {
  check_image_pair(images);
  const std::size_t n = pixel_count_of(images), width = images.width;
  Stage stage(device);
  const ImagePair on_device = {images.width, images.height, stage.in(images.rgb),
                               stage.in(images.ground_truth), stage.in(images.mask)};
  const auto planes = stage.template scratch<float>(2 * kImagePlanes * n);
  ScoreSums sums;
  stage.for_each(n, FillPlanes{on_device, planes});
  sums.squares = stage.sum(3 * n, SquaredErrors{planes});

  const SsimTaps taps = ssim_taps();
  const std::size_t down = window_count(images.height), windows = window_count(images.width) * down;
  const auto columns = stage.template scratch<SsimMoments>(down * width);
  for (std::size_t c = 0; c < 3; ++c) {
    stage.for_each(columns.size(), SsimColumns{taps, planes, c * n, width, columns});
    sums.ssim += stage.sum(windows, SsimWindows{taps, columns, on_device.mask, width});
  }

  const FlipFilters filters = flip_filters();
  const auto rows = stage.template scratch<float>(kFilteredPlanes * n);
  std::span<FlipPixel> perceived[2];
  for (int which = 0; which < 2; ++which) {
    const std::span<float> image_planes =
        planes.subspan(which * kImagePlanes * n, kImagePlanes * n);
    perceived[which] = stage.template scratch<FlipPixel>(n);
    stage.for_each(n, OpponentPixels{image_planes});
    stage.for_each(n, FilterRows{filters, image_planes, images.width, rows});
    stage.for_each(n, FilterColumns{filters, rows, images.width, perceived[which]});
  }
  sums.flip = stage.sum(n, FlipDifferences{filters, perceived[0], perceived[1], on_device.mask});
  return score_from_sums(images, sums);
}

}  // namespace redrive::kernels
