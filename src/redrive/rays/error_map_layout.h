// SPDX-License-Identifier: Apache-2.0
// The cells of the error map (kernels/gather/error_map.h) over all training images.
#pragma once

#include <vector>

#include "redrive/kernels/gather/error_map.h"

namespace redrive {

/// The cells of some pictures.
class ErrorMapLayout {
 public:
  /// A further picture, from 0. share [height, width]: how often a pixel is drawn beside others, 0
  /// never, at most 1.
  void add(int width, int height, std::span<const float> share);

  std::size_t size() const { return pixels_.size(); }
  std::span<const ErrorMapImage> pictures() const { return pictures_; }
  std::span<const float> pixels() const {
    return pixels_;
  }  ///< [size()], sum of the shares in each cell
  std::uint32_t at(int picture, std::uint32_t pixel) const {
    return cell_of_pixel(pictures_[picture], pixel);
  }
  CellRect rect(std::size_t cell) const { return rect_of_cell(pictures_, cell); }

 private:
  std::vector<ErrorMapImage> pictures_;
  std::vector<float> pixels_;
};

}  // namespace redrive
