// SPDX-License-Identifier: Apache-2.0
// Error map: importance sampling of training rays by their recent error (as instant-ngp's error
// map). Training images are cut into square cells, each with a smoothed squared error. Cells are
// sampled by resampled importance sampling (Talbot et al. 2005) instead of by a distribution
// function.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

/// Number of uniformly drawn candidates. One is kept with a probability proportional to its weight
/// (sampling weight times error). No table has to be maintained. No cell is drawn more than this
/// many times as often as uniformly, so noise and moving objects cannot take all rays.
constexpr int kCellCandidates = 8;

/// Squared error (mean over channels, smoothed over rays) of a cell without a ray yet: the maximum,
/// so that new cells are visited.
constexpr float kInitialError = 1;
constexpr float kMinCellError = 1e-5f;  ///< 50 dB PSNR: cells below it count as equal

/// The cells of one image.
struct ErrorMapImage {
  int width = 0, height = 0,
      side = 0;  ///< pixels; cells at the right and bottom border may be smaller
  int columns = 0;
  std::size_t first = 0;  ///< index of its first cell
};

/// Returns the cell of a pixel, given as y * width + x.
inline std::uint32_t cell_of_pixel(const ErrorMapImage& image, std::uint32_t pixel) {
  const int x = static_cast<int>(pixel % image.width), y = static_cast<int>(pixel / image.width);
  return static_cast<std::uint32_t>(image.first + std::size_t(y / image.side) * image.columns +
                                    x / image.side);
}

/// The pixels of a cell.
struct CellRect {
  int image = 0, x = 0, y = 0, width = 0, height = 0;  ///< pixels
};
inline CellRect rect_of_cell(std::span<const ErrorMapImage> images, std::size_t cell) {
  const auto after =
      std::upper_bound(images.begin(), images.end(), cell,
                       [](std::size_t c, const ErrorMapImage& p) { return c < p.first; });
  const ErrorMapImage& p = *(after - 1);
  const int k = static_cast<int>(cell - p.first), x = k % p.columns * p.side,
            y = k / p.columns * p.side;
  return {static_cast<int>(after - 1 - images.begin()), x, y, std::min(p.side, p.width - x),
          std::min(p.side, p.height - y)};
}

/// A sampled cell with two sums over its candidates: sampling weights, and errors times sampling
/// weights.
struct CellSample {
  std::uint32_t cell = 0;
  float pixels = 0, error = 0;
};
/// Samples a cell by `key`. pixels [cells]: sum of the sampling weights of its pixels, not all 0;
/// errors [cells]: smoothed squared errors.
inline CellSample sample_cell(std::span<const float> pixels, std::span<const float> errors,
                              std::uint64_t key) {
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

/// Weight of a ray's loss if a `share` of the rays is drawn by the error map: the uniform
/// probability of its pixel over the probability under both strategies together (balance heuristic,
/// Veach and Guibas 1995), so that the loss remains approximately the mean over all pixels. The
/// other candidates are assumed to have the mean error. In [1 / (1 - share + share *
/// kCellCandidates), 1 / (1 - share)].
inline float balance_heuristic_weight(float error, float mean_error, float share) {
  const float relative = (error + kMinCellError) / mean_error;
  const float as_often = kCellCandidates * relative / (relative + kCellCandidates - 1);
  return 1 / (1 - share + share * as_often);
}

/// Returns a cell's error after a ray with squared error `square`: exponential smoothing, squares
/// capped at kInitialError.
inline float updated_error(float error, float square) {
  constexpr float kSmoothing = 0.2f;  // weight of the newest ray
  const float seen = square > kInitialError ? kInitialError : square;
  return error == kInitialError ? seen : error + kSmoothing * (seen - error);
}

/// Updates the errors of cells in order by the squared errors of rays drawn in them, cells [n] and
/// squares [n].
inline void update_error_map(std::span<const std::uint32_t> cells, std::span<const float> squares,
                             std::span<float> errors) {
  REDRIVE_CHECK_OP(cells.size(), ==, squares.size());
  for (std::size_t i = 0; i < cells.size(); ++i)
    errors[cells[i]] = updated_error(errors[cells[i]], squares[i]);
}

}  // namespace redrive
