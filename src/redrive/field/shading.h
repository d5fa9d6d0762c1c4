// SPDX-License-Identifier: Apache-2.0
// Shading of each camera's images: smooth colour gains over the image, the same in all images of
// the camera. They hold what moves along with the camera: its lens shading, and the light of
// headlights, which no field that stands still can explain.
//   gain_c(x, y) = exp(p_c) at the centres of columns x rows equal cells of the image, bilinear
// between them, constant beyond the outermost. Parameters [cameras, 3, rows, columns]; all 0 means
// gains of 1.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

namespace redrive {

struct ShadingConfig {
  int cameras = 0;  ///< 0: no shading
  int columns = 24, rows = 16;

  std::size_t cells() const { return static_cast<std::size_t>(columns) * rows; }
  std::size_t size() const { return 3 * cells() * static_cast<std::size_t>(cameras); }
};

/// The two cells around a place along one side of the image, and the weight of the second.
struct CellWeights {
  int first, second;
  float second_weight;
};
/// place: 0..1 along the side.
inline CellWeights cells_at(int cells, float place) {
  const float at =
      std::clamp(place * static_cast<float>(cells) - 0.5f, 0.0f, static_cast<float>(cells - 1));
  const int first = static_cast<int>(at);
  return {first, std::min(first + 1, cells - 1), at - static_cast<float>(first)};
}

/// The position of a window in an image: its first pixel and the size of the whole image.
struct ImagePart {
  int x = 0, y = 0, image_width = 1, image_height = 1;
};

/// Where a row of pixels lies in its camera's whole image, whose sides are 0..1: the centres of its
/// first pixel and of the following ones.
struct ImageRow {
  float y, first_x, step_x;
};

/// Multiplies a row of channel c of an image of `camera` by its gains. parameters: all cameras';
/// camera -1 has gains of 1.
void apply_shading(const ShadingConfig& config, std::span<const float> parameters, int camera,
                   int c, const ImageRow& row, std::span<float> pixels);

}  // namespace redrive
