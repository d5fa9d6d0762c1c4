// SPDX-License-Identifier: Apache-2.0
// Where to draw more rays: the training pictures in square cells, each with what the rays drawn in it lately missed their colours by
// (as instant-ngp's error map, but resampled instead of by a distribution function).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace redrive {

/// Cells are drawn by resampling (Talbot et al. 2005): of so many drawn evenly one is kept, by its weight. So no table has to be kept up,
/// and no whole cell is drawn more than so many times as often as evenly, however large its error: noise and what moves never fall.
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

  /// What candidates were like: their mean error is that of all pixels, known better the more there were.
  struct Candidates {
    double pixels = 0, error = 0;  ///< sums of shares, and of errors over them
    float mean_error() const { return static_cast<float>(error / pixels); }
  };

  /// A cell by the errors [size()] of their pixels; a function of key. Adds its candidates. There must be a pixel with a share.
  std::uint32_t draw(std::span<const float> errors, std::uint64_t key, Candidates* candidates) const;

 private:
  struct Picture {
    int width = 0, height = 0, side = 0;  ///< pixels; the last cells of rows and columns may be smaller
    int columns = 0;
    std::size_t first = 0;  ///< its first cell
  };
  std::vector<Picture> pictures_;
  std::vector<float> pixels_;  ///< sum of the shares in each cell
};

/// What a ray counts where a share of the rays is drawn by error: the even chance of its pixel over the one that both ways to draw it
/// have together (the balance heuristic of Veach and Guibas 1995), so that the loss stays the mean over all pixels, about: the
/// other candidates are taken to have the mean error. At most 1 / (1 - share), at least 1 / (1 - share + share * kCellCandidates).
float ray_weight(float error, float mean_error, float share);

/// Takes in the squared errors of rays that were drawn in cells [n], one after the other.
void smooth_errors(std::span<const std::uint32_t> cells, std::span<const float> squares, std::span<float> errors);

}  // namespace redrive
