// SPDX-License-Identifier: Apache-2.0
// The cells of the error map (error_map.h) over all training images.
#pragma once

#include <vector>

#include "redrive/rays/error_map.h"

namespace redrive {

/// The cells of all training images, and the sampling weights in each.
class ErrorMapLayout {
 public:
  /// Appends an image. sampling_weight [height, width]: relative probability of a pixel in 0..1, 0
  /// for never.
  void add(int width, int height, std::span<const float> sampling_weight);

  std::size_t size() const { return pixels_.size(); }
  std::span<const ErrorMapImage> images() const { return images_; }
  std::span<const float> pixels() const {
    return pixels_;
  }  ///< [size()], sum of the sampling weights of its pixels
  std::uint32_t at(int image, std::uint32_t pixel) const {
    return cell_of_pixel(images_[image], pixel);
  }
  CellRect rect(std::size_t cell) const { return rect_of_cell(images_, cell); }

 private:
  std::vector<ErrorMapImage> images_;
  std::vector<float> pixels_;
};

}  // namespace redrive
