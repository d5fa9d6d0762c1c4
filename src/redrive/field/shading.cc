// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/shading.h"

#include <vector>

namespace redrive {

void apply_shading(const ShadingConfig& config, std::span<const float> parameters, int camera,
                   int c, const ImageRow& row, std::span<float> pixels) {
  if (camera < 0 || config.size() == 0) return;
  const float* const channel =
      parameters.data() + (3 * static_cast<std::size_t>(camera) + c) * config.cells();
  const CellWeights above = cells_at(config.rows, row.y);
  std::vector<float> gains(config.columns);
  for (int k = 0; k < config.columns; ++k)
    gains[k] = (1 - above.second_weight) * std::exp(channel[above.first * config.columns + k]) +
               above.second_weight * std::exp(channel[above.second * config.columns + k]);
  // Linear between the centres of cells k - 1 and k, where the pixels of interval k lie.
  const float cell = 1 / (row.step_x * static_cast<float>(config.columns));  // pixels
  std::size_t i = 0;
  for (int k = 0; k <= config.columns; ++k) {
    const float left = gains[std::max(k - 1, 0)], right = gains[std::min(k, config.columns - 1)],
                centre = (static_cast<float>(k) + 0.5f) * cell - row.first_x / row.step_x,
                slope = (right - left) / cell;
    const std::size_t end = k == config.columns
                                ? pixels.size()
                                : static_cast<std::size_t>(std::clamp(
                                      std::ceil(centre), 0.0f, static_cast<float>(pixels.size())));
    for (; i < end; ++i) pixels[i] *= right + slope * (static_cast<float>(i) - centre);
  }
}

}  // namespace redrive
