// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_layout.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "redrive/field/gaussian_blocks.h"

namespace redrive {

std::uint32_t morton_key(const float* position) {
  constexpr int kBits = 10;
  std::uint32_t cell[3];
  for (int k = 0; k < 3; ++k) {
    const float contracted =
        std::copysign(std::log1p(std::fabs(position[k]) / 10), position[k]);  // -6..6 within 4 km
    cell[k] = static_cast<std::uint32_t>(
        std::clamp((contracted + 6) / 12 * ((1 << kBits) - 1), 0.0f, float((1 << kBits) - 1)));
  }
  std::uint32_t key = 0;
  for (int bit = kBits - 1; bit >= 0; --bit)
    for (int k = 0; k < 3; ++k) key = key << 1 | (cell[k] >> bit & 1);
  return key;
}

std::size_t first_of(const GaussianLayout& layout, std::size_t part) {
  return part == 0 ? 0 : layout.first_block(part - 1) * kGaussianBlock;
}

GaussianLayout layout_of(std::span<const std::size_t> sizes) {
  GaussianLayout layout{.world = sizes[0], .actor_ends = {}};
  for (std::size_t part = 1; part < sizes.size(); ++part)
    layout.actor_ends.push_back(static_cast<std::int64_t>(
        layout.blocks() + std::max<std::size_t>(1, gaussian_blocks(sizes[part]))));
  return layout;
}

GaussianLayout layout_of(std::span<const GaussianList> lists) {
  std::vector<std::size_t> sizes;
  for (const GaussianList& list : lists) sizes.push_back(list.size());
  return layout_of(std::span<const std::size_t>(sizes));
}

void write_blocks(std::span<const GaussianList> lists, const GaussianLayout& layout,
                  Buffer<float>* numbers) {
  for (std::size_t part = 0; part < lists.size(); ++part) {
    const GaussianList& list = lists[part];
    const std::size_t first = first_of(layout, part);
    std::vector<std::pair<std::uint32_t, std::uint32_t>> order(list.size());
    for (std::size_t i = 0; i < order.size(); ++i)
      order[i] = {morton_key(&list.rows[i * std::size_t{kGaussianRows}]),
                  static_cast<std::uint32_t>(i)};
    std::ranges::sort(order);
    for (std::size_t i = 0; i < order.size(); ++i)
      for (int row = 0; row < kGaussianRows; ++row)
        (*numbers)[gaussian_slot(first + i, row)] =
            list.rows[order[i].second * std::size_t{kGaussianRows} + row];
    clear_unused(first + order.size(), first_of(layout, part + 1), numbers->data());
  }
}

}  // namespace redrive
