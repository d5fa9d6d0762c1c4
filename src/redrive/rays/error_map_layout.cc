// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/error_map_layout.h"

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kCellsAcross = 32;  // along the longer side of an image

}  // namespace

void ErrorMapLayout::add(int width, int height, std::span<const float> sampling_weight) {
  REDRIVE_CHECK_OP(sampling_weight.size(), ==, std::size_t(width) * height);
  const int side = (std::max(width, height) + kCellsAcross - 1) / kCellsAcross;
  const int columns = (width + side - 1) / side, rows = (height + side - 1) / side;
  images_.push_back({width, height, side, columns, size()});
  const std::size_t cells = std::size_t(columns) * rows;
  REDRIVE_CHECK_OP(size() + cells, <, std::size_t{1} << 32);
  for (std::size_t cell = 0; cell < cells; ++cell) {
    pixels_.push_back(0);
    const CellRect r = rect(pixels_.size() - 1);
    for (int y = r.y; y < r.y + r.height; ++y)
      for (int x = r.x; x < r.x + r.width; ++x)
        pixels_.back() += sampling_weight[std::size_t(y) * width + x];
  }
}

}  // namespace redrive
