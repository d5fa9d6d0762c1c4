// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/image_score.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/optim/flip.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {
namespace {

using Math = NumberMath<double>;
/// Three channels of an image, row by row; black where masked.
using Planes = std::vector<double>;

/// The plain loops. x and y are the images, in [0, 1].
class PlainScore {
 public:
  explicit PlainScore(const ImagePair& images) : images_(images) {
    for (Planes* planes : {&x_, &y_}) planes->assign(3 * size(), 0);
    for (std::size_t i = 0; i < size(); ++i)
      for (std::size_t c = 0; counts(i) && c < 3; ++c) {
        x_[c * size() + i] = static_cast<double>(images.rgb[3 * i + c]);
        y_[c * size() + i] =
            static_cast<double>(static_cast<float>(images.ground_truth[3 * i + c]) / 255.0f);
      }
  }

  ScoreSums sums() const {
    ScoreSums sums;
    add_squares(&sums);
    add_ssim(&sums);
    add_flip(&sums);
    return sums;
  }

 private:
  std::size_t size() const { return static_cast<std::size_t>(images_.width) * images_.height; }
  bool counts(std::size_t pixel) const { return images_.mask.empty() || images_.mask[pixel] != 0; }

  void add_squares(ScoreSums* sums) const {
    for (std::size_t i = 0; i < size(); ++i) {
      double luma_error = 0;
      for (std::size_t c = 0; c < 3; ++c) {
        const double error = x_[c * size() + i] - y_[c * size() + i];
        sums->squares[c] += error * error;
        luma_error += error / 3;
      }
      sums->luma_squares += luma_error * luma_error;
      sums->pixels += counts(i);
    }
  }

  void add_ssim(ScoreSums* sums) const {
    const SsimTaps taps = ssim_taps();
    const int width = images_.width;
    std::vector<SsimMoments> columns(static_cast<std::size_t>(width));
    for (int y = kSsimRadius; y < images_.height - kSsimRadius; ++y)
      for (std::size_t c = 0; c < 3; ++c) {
        for (int x = 0; x < width; ++x) {
          columns[x] = {};
          for (int i = 0; i < kSsimTaps; ++i) {
            const std::size_t at =
                c * size() + static_cast<std::size_t>(y + i - kSsimRadius) * width + x;
            columns[x].add(taps[i], x_[at], y_[at]);
          }
        }
        for (int x = kSsimRadius; x < width - kSsimRadius; ++x) {
          if (!counts(static_cast<std::size_t>(y) * width + x)) continue;
          SsimMoments means;
          for (int i = 0; i < kSsimTaps; ++i) means.add(taps[i], columns[x + i - kSsimRadius]);
          sums->ssim += ssim_from_moments(means);
          sums->windows += c == 0;
        }
      }
  }

  /// Filters a plane along x and y, which replicate the border.
  template <int n>
  Planes filtered(const double* plane, const float (&along_x)[n], const float (&along_y)[n]) const {
    const int width = images_.width, height = images_.height;
    Planes half(size()), out(size());
    const auto filter = [&](const double* from, const float* taps, bool is_row, double* to) {
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          double sum = 0;
          for (int i = 0; i < n; ++i) {
            const int at_x = is_row ? std::clamp(x + i - n / 2, 0, width - 1) : x,
                      at_y = is_row ? y : std::clamp(y + i - n / 2, 0, height - 1);
            sum +=
                static_cast<double>(taps[i]) * from[static_cast<std::size_t>(at_y) * width + at_x];
          }
          to[static_cast<std::size_t>(y) * width + x] = sum;
        }
    };
    filter(plane, along_y, false, half.data());
    filter(half.data(), along_x, true, out.data());
    return out;
  }

  /// Returns what FLIP perceives of an image.
  std::vector<FlipPixel<Math>> perceived(const FlipFilters& filters, const Planes& image) const {
    Planes opponent(3 * size());
    for (std::size_t i = 0; i < size(); ++i) {
      const double srgb[] = {image[i], image[size() + i], image[2 * size() + i]};
      double out[3];
      flip_opponent<Math>(srgb, out);
      for (std::size_t c = 0; c < 3; ++c) opponent[c * size() + i] = out[c];
    }
    Planes colour(3 * size());
    for (const FlipFilters::Term& term : filters.colour) {
      const std::size_t channel = term.channel * size();
      const Planes of_term = filtered(&opponent[channel], term.taps, term.taps);
      for (std::size_t i = 0; i < size(); ++i)
        colour[channel + i] += static_cast<double>(term.weight) * of_term[i];
    }
    const double* const y = opponent.data();
    const Planes first_x = filtered(y, filters.first, filters.smooth),
                 first_y = filtered(y, filters.smooth, filters.first),
                 second_x = filtered(y, filters.second, filters.smooth),
                 second_y = filtered(y, filters.smooth, filters.second);
    std::vector<FlipPixel<Math>> out(size());
    for (std::size_t i = 0; i < size(); ++i) {
      const double of_pixel[] = {colour[i], colour[size() + i], colour[2 * size() + i]};
      flip_lab<Math>(of_pixel, out[i].lab);
      out[i].edges = flip_magnitude<Math>(first_x[i], first_y[i]);
      out[i].points = flip_magnitude<Math>(second_x[i], second_y[i]);
    }
    return out;
  }

  void add_flip(ScoreSums* sums) const {
    const FlipFilters filters = flip_filters();
    const std::vector<FlipPixel<Math>> x = perceived(filters, x_), y = perceived(filters, y_);
    for (std::size_t i = 0; i < size(); ++i)
      if (counts(i)) sums->flip += flip_difference<Math>(filters.largest, x[i], y[i]);
  }

  const ImagePair& images_;
  Planes x_, y_;
};

}  // namespace

ImageScore score_from_sums(std::span<const ScoreSums> parts) {
  ScoreSums sums;
  for (const ScoreSums& part : parts) {
    sums.luma_squares += part.luma_squares;
    for (int c = 0; c < 3; ++c) sums.squares[c] += part.squares[c];
    sums.ssim += part.ssim;
    sums.flip += part.flip;
    sums.pixels += part.pixels;
    sums.windows += part.windows;
  }
  const auto mean = [](double sum, std::int64_t count) {
    return count > 0 ? sum / static_cast<double>(count) : std::numeric_limits<double>::quiet_NaN();
  };
  const auto psnr_db = [&](double squares, std::int64_t count) {
    return -10 * std::log10(mean(squares, count));
  };
  const auto& [red, green, blue] = sums.squares;
  return {.psnr_db = psnr_db(red + green + blue, 3 * sums.pixels),
          .luma_psnr_db = psnr_db(sums.luma_squares, sums.pixels),
          .channel_psnr_db = {psnr_db(red, sums.pixels), psnr_db(green, sums.pixels),
                              psnr_db(blue, sums.pixels)},
          .ssim = mean(sums.ssim, 3 * sums.windows),
          .flip = mean(sums.flip, sums.pixels)};
}

void check_image_pair(const ImagePair& images) {
  REDRIVE_CHECK_OP(images.width, >=, 1);
  REDRIVE_CHECK_OP(images.height, >=, 1);
  const std::size_t pixels = static_cast<std::size_t>(images.width) * images.height;
  REDRIVE_CHECK_OP(images.rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(images.ground_truth.size(), ==, 3 * pixels);
  if (!images.mask.empty()) REDRIVE_CHECK_OP(images.mask.size(), ==, pixels);
}

ImageScore score_images(const ImagePair& images) {
  check_image_pair(images);
  const ScoreSums sums = PlainScore(images).sums();
  return score_from_sums({&sums, 1});
}

}  // namespace redrive::kernels
