// SPDX-License-Identifier: Apache-2.0
// Where to draw more rays: the training pictures in square cells, each with what the rays drawn in
// it lately missed their colours by (as instant-ngp's error map, but resampled instead of by a
// distribution function).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "redrive/base/error.h"
#include "redrive/base/host_device.h"
#include "redrive/base/rng.h"

namespace redrive {

/// Cells are drawn by resampling (Talbot et al. 2005): of so many drawn evenly one is kept, by its
/// weight. So no table has to be kept up, and no whole cell is drawn more than so many times as
/// often as evenly, however large its error: noise and what moves never fall.
constexpr int kCellCandidates = 8;

/// The squared error (mean over channels, smoothed over rays) of a cell that no ray has been drawn
/// in, as bad as can be.
constexpr float kInitialError = 1;
constexpr float kMinCellError = 1e-5f;  ///< 50 dB are good enough anywhere

/// How a picture is cut into cells.
struct ErrorMapImage {
  int width = 0, height = 0,
      side = 0;  ///< pixels; the last cells of rows and columns may be smaller
  int columns = 0;
  std::size_t first = 0;  ///< its first cell
};

/// The cell of a pixel, y * width + x.
REDRIVE_HD inline std::uint32_t cell_of_pixel(const ErrorMapImage& picture, std::uint32_t pixel) {
  const int x = static_cast<int>(pixel % picture.width),
            y = static_cast<int>(pixel / picture.width);
  return static_cast<std::uint32_t>(
      picture.first + std::size_t(y / picture.side) * picture.columns + x / picture.side);
}

/// Where a cell is.
struct CellRect {
  int picture = 0, x = 0, y = 0, width = 0, height = 0;  ///< pixels
};
REDRIVE_HD inline CellRect rect_of_cell(std::span<const ErrorMapImage> pictures, std::size_t cell) {
  const auto after =
      std::upper_bound(pictures.begin(), pictures.end(), cell,
                       [](std::size_t c, const ErrorMapImage& p) { return c < p.first; });
  const ErrorMapImage& p = *(after - 1);
  const int k = static_cast<int>(cell - p.first), x = k % p.columns * p.side,
            y = k / p.columns * p.side;
  return {static_cast<int>(after - 1 - pictures.begin()), x, y, std::min(p.side, p.width - x),
          std::min(p.side, p.height - y)};
}

/// A cell that was drawn, and what its candidates were like: sums of shares, and of errors over
/// them.
struct CellSample {
  std::uint32_t cell = 0;
  float pixels = 0, error = 0;
};
/// A cell by `pixels`, the sum of the shares in each, and the errors of their pixels; a function of
/// key. There must be a pixel with a share.
REDRIVE_HD inline CellSample sample_cell(std::span<const float> pixels,
                                         std::span<const float> errors, std::uint64_t key) {
  CellSample drawn;
  for (int i = 0; i < kCellCandidates || drawn.error == 0; ++i) {
    const std::uint64_t bits = random_bits(key, i);
    const auto cell = static_cast<std::uint32_t>((bits >> 32) * pixels.size() >> 32);
    const float weight = pixels[cell] * (errors[cell] + kMinCellError);
    drawn.error += weight;
    drawn.pixels += pixels[cell];
    if (drawn.error == weight ||
        static_cast<float>(bits & 0xffffff) * 0x1p-24f * drawn.error < weight)
      drawn.cell = cell;
  }
  return drawn;
}

/// What a ray counts where a share of the rays is drawn by error: the even chance of its pixel over
/// the one that both ways to draw it have together (the balance heuristic of Veach and Guibas
/// 1995), so that the loss stays the mean over all pixels, about: the other candidates are taken to
/// have the mean error. At most 1 / (1 - share), at least 1 / (1 - share + share *
/// kCellCandidates).
REDRIVE_HD inline float balance_heuristic_weight(float error, float mean_error, float share) {
  const float relative = (error + kMinCellError) / mean_error;
  const float as_often = kCellCandidates * relative / (relative + kCellCandidates - 1);
  return 1 / (1 - share + share * as_often);
}

/// A cell's error, once a ray has been drawn there that missed by `square`.
REDRIVE_HD inline float updated_error(float error, float square) {
  constexpr float kSmoothing = 0.2f;  // of a ray in its cell's error: the last ten or so count
  const float seen = square > kInitialError ? kInitialError : square;
  return error == kInitialError ? seen : error + kSmoothing * (seen - error);
}

/// Updates the errors of cells by the squared errors of rays drawn in them, cells [n] and squares
/// [n], in order.
inline void update_error_map(std::span<const std::uint32_t> cells, std::span<const float> squares,
                             std::span<float> errors) {
  REDRIVE_CHECK_OP(cells.size(), ==, squares.size());
  for (std::size_t i = 0; i < cells.size(); ++i)
    errors[cells[i]] = updated_error(errors[cells[i]], squares[i]);
}

}  // namespace redrive
