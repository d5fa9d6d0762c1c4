// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/pixel_cells.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr int kCellsAcross = 32;      // along the longer side of a picture
constexpr float kSmoothing = 0.2f;    // of a ray in its cell's error: the last ten or so count
constexpr float kLeastError = 1e-5f;  // 50 dB are good enough anywhere

}  // namespace

void PixelCells::add(int width, int height, std::span<const float> share) {
  REDRIVE_CHECK_OP(share.size(), ==, std::size_t(width) * height);
  const int side = (std::max(width, height) + kCellsAcross - 1) / kCellsAcross;
  const int columns = (width + side - 1) / side, rows = (height + side - 1) / side;
  pictures_.push_back({width, height, side, columns, size()});
  const std::size_t cells = std::size_t(columns) * rows;
  REDRIVE_CHECK_OP(size() + cells, <, std::size_t{1} << 32);
  for (std::size_t cell = 0; cell < cells; ++cell) {
    pixels_.push_back(0);
    const Rect r = rect(pixels_.size() - 1);
    for (int y = r.y; y < r.y + r.height; ++y)
      for (int x = r.x; x < r.x + r.width; ++x) pixels_.back() += share[std::size_t(y) * width + x];
  }
}

std::uint32_t PixelCells::at(int picture, std::uint32_t pixel) const {
  const Picture& p = pictures_[picture];
  const int x = static_cast<int>(pixel % p.width), y = static_cast<int>(pixel / p.width);
  return static_cast<std::uint32_t>(p.first + std::size_t(y / p.side) * p.columns + x / p.side);
}

PixelCells::Rect PixelCells::rect(std::size_t cell) const {
  const auto after = std::ranges::upper_bound(pictures_, cell, {}, &Picture::first);
  const Picture& p = *std::prev(after);
  const int k = static_cast<int>(cell - p.first), x = k % p.columns * p.side, y = k / p.columns * p.side;
  return {static_cast<int>(std::prev(after) - pictures_.begin()), x, y, std::min(p.side, p.width - x),
          std::min(p.side, p.height - y)};
}

std::uint32_t PixelCells::draw(std::span<const float> errors, std::uint64_t key, Candidates* candidates) const {
  std::uint32_t drawn = 0;
  float total = 0, pixels = 0;
  for (int i = 0; i < kCellCandidates || total == 0; ++i) {
    const std::uint64_t bits = random_bits(key, i);
    const auto cell = static_cast<std::uint32_t>((bits >> 32) * size() >> 32);
    const float weight = pixels_[cell] * (errors[cell] + kLeastError);
    total += weight;
    pixels += pixels_[cell];
    if (total == weight || static_cast<float>(bits & 0xffffff) * 0x1p-24f * total < weight) drawn = cell;
  }
  candidates->pixels += pixels;
  candidates->error += total;
  return drawn;
}

float ray_weight(float error, float mean_error, float share) {
  const float relative = (error + kLeastError) / mean_error;
  const float as_often = kCellCandidates * relative / (relative + kCellCandidates - 1);
  return 1 / (1 - share + share * as_often);
}

void smooth_errors(std::span<const std::uint32_t> cells, std::span<const float> squares, std::span<float> errors) {
  REDRIVE_CHECK_OP(cells.size(), ==, squares.size());
  for (std::size_t i = 0; i < cells.size(); ++i) {
    float& error = errors[cells[i]];
    if (error == kUnseenError)
      error = std::min(squares[i], kUnseenError);
    else
      error += kSmoothing * (std::min(squares[i], kUnseenError) - error);
  }
}

}  // namespace redrive
