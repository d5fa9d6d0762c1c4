// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/image_score.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/optim/flip.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {
namespace {

// Both images are stored as planes [2, 4, height, width]: red, green, blue (black where masked) and
// one for FLIP's luminance. FLIP overwrites the colours by its opponent channels.
constexpr std::size_t kImagePlanes = 4;

std::size_t pixel_count_of(const ImagePair& images) {
  return static_cast<std::size_t>(images.width) * static_cast<std::size_t>(images.height);
}

void check_image_pair(const ImagePair& images) {
  REDRIVE_CHECK_OP(images.width, >=, 1);
  REDRIVE_CHECK_OP(images.height, >=, 1);
  const std::size_t pixels = pixel_count_of(images);
  REDRIVE_CHECK_OP(images.rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(images.ground_truth.size(), ==, 3 * pixels);
  if (!images.mask.empty()) REDRIVE_CHECK_OP(images.mask.size(), ==, pixels);
}

bool counts(std::span<const std::uint8_t> mask, std::size_t pixel) {
  return mask.empty() || mask[pixel] != 0;
}

void fill_planes_of_pixel(const ImagePair& images, std::size_t pixel, std::span<float> planes) {
  const std::size_t n = planes.size() / (2 * kImagePlanes);
  const bool used = counts(images.mask, pixel);
  for (std::size_t c = 0; c < 3; ++c) {
    planes[c * n + pixel] = used ? images.rgb[3 * pixel + c] : 0.0f;
    planes[(kImagePlanes + c) * n + pixel] =
        used ? static_cast<float>(images.ground_truth[3 * pixel + c]) / 255.0f : 0.0f;
  }
}

/// Returns the error of channel at / n of pixel at % n.
double error_at(std::span<const float> planes, std::size_t at) {
  return static_cast<double>(planes[at]) - planes[planes.size() / 2 + at];
}

/// Returns the number of windows along a row or column of `size` pixels.
std::size_t window_count(int size) {
  return static_cast<std::size_t>(std::max(0, size - 2 * kSsimRadius));
}

/// Returns the weighted moments of a window's column that begins at index `at`.
SsimMoments ssim_column(const SsimTaps& taps, std::span<const float> planes, std::size_t at,
                        std::size_t width) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i, at += width)
    means.add(taps[i], planes[at], planes[planes.size() / 2 + at]);
  return means;
}

/// Returns the SSIM of the window of columns[0], columns[1], ...
double ssim_window(const SsimTaps& taps, const SsimMoments* columns) {
  SsimMoments means;
  for (int i = 0; i < kSsimTaps; ++i) means.add(taps[i], columns[i]);
  return ssim_from_moments(means);
}

/// Converts a pixel of one image's planes to opponent colours and luminance.
void opponent_colour_of_pixel(std::span<float> planes, std::size_t pixel) {
  const std::size_t n = planes.size() / kImagePlanes;
  const FlipColour opponent =
      flip_opponent({planes[pixel], planes[n + pixel], planes[2 * n + pixel]});
  for (std::size_t c = 0; c < 3; ++c) planes[c * n + pixel] = opponent[c];
  planes[3 * n + pixel] = flip_luminance(opponent);
}

/// Sums over the pixels or windows that count.
struct ScoreSums {
  double luma_squares = 0, squares[3] = {0, 0, 0}, ssim = 0, flip = 0;
};
ImageScore score_from_sums(const ImagePair& images, const ScoreSums& sums) {
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
  const auto psnr_db = [&](double squares, std::size_t count) {
    return -10 * std::log10(mean(squares, count));
  };
  const auto& [red, green, blue] = sums.squares;
  return {.psnr_db = psnr_db(red + green + blue, 3 * pixels),
          .luma_psnr_db = psnr_db(sums.luma_squares, pixels),
          .channel_psnr_db = {psnr_db(red, pixels), psnr_db(green, pixels), psnr_db(blue, pixels)},
          .ssim = mean(sums.ssim, 3 * windows),
          .flip = mean(sums.flip, pixels)};
}

/// Filters some rows of a plane along x and y. Reads neighbouring rows beyond them as well.
template <std::size_t n>
cv::Mat filtered(const cv::Mat& rows, const std::array<float, n>& along_x,
                 const std::array<float, n>& along_y) {
  const auto kernel = [](const std::array<float, n>& taps) {
    return cv::Mat(static_cast<int>(n), 1, CV_32F, const_cast<float*>(taps.data()));
  };
  cv::Mat out;
  cv::sepFilter2D(rows, out, CV_32F, kernel(along_x), kernel(along_y), {-1, -1}, 0,
                  cv::BORDER_REPLICATE);
  return out;
}

/// Returns FLIP's perceived colours and features of some rows of an image, from its planes.
std::vector<FlipPixel> perceived_rows(const FlipFilters& filters, std::span<const cv::Mat> rows) {
  cv::Mat colour[FlipFilters::kTerms];
  for (int t = 0; t < FlipFilters::kTerms; ++t) {
    const FlipFilters::Term& term = filters.colour[t];
    colour[t] = filtered(rows[term.channel], term.taps, term.taps);
  }
  const auto &luminance = rows[3], first_x = filtered(luminance, filters.first, filters.smooth),
             first_y = filtered(luminance, filters.smooth, filters.first),
             second_x = filtered(luminance, filters.second, filters.smooth),
             second_y = filtered(luminance, filters.smooth, filters.second);
  std::vector<FlipPixel> perceived(luminance.total());
  for (std::size_t i = 0; i < perceived.size(); ++i) {
    std::array<float, FlipFilters::kTerms> of_pixel;
    for (int t = 0; t < FlipFilters::kTerms; ++t) of_pixel[t] = colour[t].ptr<float>()[i];
    perceived[i] = {flip_lab(filters, of_pixel),
                    flip_magnitude(first_x.ptr<float>()[i], first_y.ptr<float>()[i]),
                    flip_magnitude(second_x.ptr<float>()[i], second_y.ptr<float>()[i])};
  }
  return perceived;
}

}  // namespace

ImageScore score_images(const ImagePair& images, ThreadPool& pool) {
  check_image_pair(images);
  const std::size_t width = images.width, height = images.height, n = pixel_count_of(images);
  const std::size_t rows_at_once = height / (2 * pool.threads()) + 1;
  const auto for_rows = [&](std::size_t rows, const auto& body) {
    pool.run_ranges(rows, rows_at_once, body);
  };
  const auto for_pixels = [&](const auto& body) {
    for_rows(height, [&](std::size_t begin, std::size_t end) {
      for (std::size_t pixel = begin * width; pixel < end * width; ++pixel) body(pixel);
    });
  };
  const auto memory = std::make_unique_for_overwrite<float[]>(2 * kImagePlanes * n);
  const std::span<float> planes(memory.get(), 2 * kImagePlanes * n);
  const std::span<float> image_planes[] = {planes.first(planes.size() / 2),
                                           planes.last(planes.size() / 2)};
  std::vector<double> terms(n);  // 0 where masked
  ScoreSums sums;

  for_pixels([&](std::size_t pixel) { fill_planes_of_pixel(images, pixel, planes); });
  for (std::size_t pixel = 0; pixel < n; ++pixel) {
    double luma_error = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      const double error = error_at(planes, c * n + pixel);
      sums.squares[c] += error * error;
      luma_error += error / 3;
    }
    sums.luma_squares += luma_error * luma_error;
  }

  const SsimTaps taps = ssim_taps();
  const std::size_t across = window_count(images.width), down = window_count(images.height);
  for (std::size_t c = 0; c < 3; ++c) {
    for_rows(down, [&](std::size_t begin, std::size_t end) {
      std::vector<SsimMoments> columns(width);
      for (std::size_t y = begin; y < end; ++y) {
        for (std::size_t x = 0; x < width; ++x)
          columns[x] = ssim_column(taps, planes, c * n + y * width + x, width);
        for (std::size_t x = 0; x < across; ++x)
          terms[y * across + x] = counts(images.mask, (y + kSsimRadius) * width + x + kSsimRadius)
                                      ? ssim_window(taps, &columns[x])
                                      : 0;
      }
    });
    for (std::size_t i = 0; i < across * down; ++i) sums.ssim += terms[i];
  }

  const FlipFilters filters = flip_filters();
  for_pixels([&](std::size_t pixel) {
    for (const std::span<float> planes_of_one : image_planes)
      opponent_colour_of_pixel(planes_of_one, pixel);
  });
  for_rows(height, [&](std::size_t begin, std::size_t end) {
    std::vector<FlipPixel> perceived[2];
    for (int which = 0; which < 2; ++which) {
      cv::Mat rows[kImagePlanes];
      for (std::size_t k = 0; k < kImagePlanes; ++k)
        rows[k] = cv::Mat(images.height, images.width, CV_32F, &image_planes[which][k * n])
                      .rowRange(static_cast<int>(begin), static_cast<int>(end));
      perceived[which] = perceived_rows(filters, rows);
    }
    for (std::size_t i = 0, pixel = begin * width; i < perceived[0].size(); ++i, ++pixel)
      terms[pixel] = counts(images.mask, pixel)
                         ? flip_difference(filters, perceived[0][i], perceived[1][i])
                         : 0;
  });
  for (const double term : terms) sums.flip += term;
  return score_from_sums(images, sums);
}

}  // namespace redrive::kernels
