// SPDX-License-Identifier: Apache-2.0
// Where to draw more rays: the training pictures in square cells, each with what the rays drawn in it lately missed their colours by
// (the error map of instant-ngp, Mueller et al. 2022, appendix E, but resampled instead of by a distribution function).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace redrive {

/// Cells are drawn by resampling (Talbot et al. 2005): of so many drawn evenly one is kept, by its weight. So no table has to be kept up,
/// and no cell is drawn more than so many times as often as evenly, however large its error: noise and what moves never fall.
constexpr int kCellCandidates = 8;

/// The squared error (mean over channels, smoothed over rays) of a cell that no ray has been drawn in, as bad as can be.
constexpr float kUnseenError = 1;

class PixelCells {
 public:
  struct Rect {
    int picture = 0, x = 0, y = 0, width = 0, height = 0;  ///< pixels
  };

  /// A further picture, from 0. share [height, width]: how often a pixel is drawn beside others, 0 never, at most 1.
  void add(int width, int height, std::span<const float> share);

  std::size_t size() const { return pixels_.size(); }
  std::uint32_t at(int picture, std::uint32_t pixel) const;  ///< pixel: y * width + x
  Rect rect(std::size_t cell) const;

  /// A cell by the errors [size()] of their pixels; a function of key. There must be a pixel with a share.
  std::uint32_t draw(std::span<const float> errors, std::uint64_t key) const;

 private:
  struct Picture {
    int width = 0, height = 0, side = 0;  ///< pixels; the last cells of rows and columns may be smaller
    int columns = 0;
    std::size_t first = 0;  ///< its first cell
  };
  std::vector<Picture> pictures_;
  std::vector<float> pixels_;  ///< sum of the shares in each cell
};

/// Takes in the squared errors of rays that were drawn in cells [n], one after the other.
void smooth_errors(std::span<const std::uint32_t> cells, std::span<const float> squares, std::span<float> errors);

}  // namespace redrive
