// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/densify_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/field/gaussian_blocks.h"

namespace redrive {
namespace {

constexpr float kChildOffset = 0.75f;  // of the parent's standard deviation, to either side
constexpr float kChildScale = 0.6f, kChildOtherScale = 0.92f;  // along the axis, along the others

/// Position on a Morton curve through space contracted by its logarithm.
std::uint64_t morton_key(const float* position) {
  constexpr int kBits = 10;
  std::uint32_t cell[3];
  for (int k = 0; k < 3; ++k) {
    const float contracted =
        std::copysign(std::log1p(std::fabs(position[k]) / 10), position[k]);  // -6..6 within 4 km
    cell[k] = static_cast<std::uint32_t>(
        std::clamp((contracted + 6) / 12 * ((1 << kBits) - 1), 0.0f, float((1 << kBits) - 1)));
  }
  std::uint64_t key = 0;
  for (int bit = kBits - 1; bit >= 0; --bit)
    for (int k = 0; k < 3; ++k) key = key << 1 | (cell[k] >> bit & 1);
  return key;
}

/// Where a Gaussian comes from: itself, or one of the halves of a split one.
struct Source {
  std::uint32_t part;  ///< 0: the world, from 1 on actors
  std::uint64_t key;
  std::uint32_t from;
  std::int8_t half;  ///< 0: whole; 1, -1: halves along the longest axis
};

int longest_axis(const float* numbers, std::size_t i) {
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (numbers[gaussian_slot(i, kLogScaleRow + k)] >
        numbers[gaussian_slot(i, kLogScaleRow + axis)])
      axis = k;
  return axis;
}

/// Direction of a Gaussian's axis in the world times its standard deviation.
std::array<float, 3> axis_of(const float* numbers, std::size_t i, int axis) {
  float q[4], norm = 0;
  for (int k = 0; k < 4; ++k) {
    q[k] = numbers[gaussian_slot(i, kQuaternionRow + k)];
    norm += q[k] * q[k];
  }
  for (float& x : q) x /= std::sqrt(norm);
  float r[3][3];
  rotation_from_quaternion<NumberMath<float>>(q, r);
  const float scale = std::exp(numbers[gaussian_slot(i, kLogScaleRow + axis)]);
  return {scale * r[0][axis], scale * r[1][axis], scale * r[2][axis]};
}

/// Returns the layout of so many Gaussians, of the world first.
GaussianLayout layout_of(std::span<const std::size_t> sizes) {
  GaussianLayout layout{.world = sizes[0], .actor_ends = {}};
  for (std::size_t part = 1; part < sizes.size(); ++part)
    layout.actor_ends.push_back(static_cast<std::int64_t>(
        layout.blocks() + std::max<std::size_t>(1, gaussian_blocks(sizes[part]))));
  return layout;
}

/// Index of the first Gaussian of a part.
std::size_t first_of(const GaussianLayout& layout, std::size_t part) {
  return part == 0 ? 0 : layout.first_block(part - 1) * kGaussianBlock;
}

/// Whether a Gaussian is within the bounds of its part.
bool within_bounds(const DensifyOptions& options, std::size_t part, const float* numbers,
                   std::size_t i) {
  if (part == 0 || options.actor_bounds.empty()) return true;
  for (int k = 0; k < 3; ++k)
    if (!(std::fabs(numbers[gaussian_slot(i, kPositionRow + k)]) <=
          options.actor_bounds[part - 1][k]))
      return false;
  return true;
}

}  // namespace

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
    std::vector<std::pair<std::uint64_t, std::uint32_t>> order(list.size());
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

void densify(const DensifyOptions& options, std::uint64_t key, std::size_t tail,
             GaussianLayout* layout, Buffer<float>* numbers, AdamState* adam) {
  const float* const p = numbers->data();
  const std::size_t parts = 1 + layout->actor_ends.size(),
                    n = layout->blocks() * kGaussianBlock;  // with unused lanes, transparent ones
  std::vector<std::uint32_t> part_of(n);
  for (std::size_t part = 0; part < parts; ++part)
    std::fill(part_of.begin() + static_cast<std::ptrdiff_t>(first_of(*layout, part)),
              part_of.begin() + static_cast<std::ptrdiff_t>(first_of(*layout, part + 1)),
              static_cast<std::uint32_t>(part));
  const float least = std::log(options.min_opacity / (1 - options.min_opacity));
  std::vector<std::uint32_t> alive;
  std::vector<std::pair<float, std::uint32_t>> candidates;  // drawn in ascending order
  for (std::size_t i = 0; i < n; ++i) {
    if (!(p[gaussian_slot(i, kOpacityRow)] >= least)) continue;
    if (!within_bounds(options, part_of[i], p, i)) continue;
    alive.push_back(static_cast<std::uint32_t>(i));
    const float error = adam->first_moment[gaussian_slot(i, kDistanceRow)],
                scale = std::exp(p[gaussian_slot(i, kLogScaleRow + longest_axis(p, i))]);
    if (error > 0 && scale > options.min_scale * p[gaussian_slot(i, kDistanceRow)])
      candidates.emplace_back(-std::log(std::max(random_unit(key, i), 1e-9f)) / error,
                              static_cast<std::uint32_t>(i));
  }
  const std::size_t wanted = options.target > alive.size() ? options.target - alive.size() : 0,
                    splits = std::min(wanted, candidates.size() / 3);
  std::nth_element(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(splits),
                   candidates.end());
  std::vector<bool> split(n);
  for (std::size_t k = 0; k < splits; ++k) split[candidates[k].second] = true;

  std::vector<Source> sources;
  sources.reserve(alive.size() + splits);
  for (const std::uint32_t i : alive) {
    float position[3];
    for (int k = 0; k < 3; ++k) position[k] = p[gaussian_slot(i, kPositionRow + k)];
    const std::uint64_t at = morton_key(position);
    if (!split[i]) {
      sources.push_back({part_of[i], at, i, 0});
    } else {
      sources.push_back({part_of[i], at, i, 1});
      sources.push_back({part_of[i], at, i, -1});
    }
  }
  std::ranges::stable_sort(sources, {}, [](const Source& s) { return std::pair(s.part, s.key); });

  std::vector<std::size_t> sizes(parts);
  for (const Source& source : sources) ++sizes[source.part];
  const GaussianLayout before_layout =
      std::exchange(*layout, layout_of(std::span<const std::size_t>(sizes)));
  const std::size_t old_size = before_layout.blocks() * kBlockSize,
                    size = layout->blocks() * kBlockSize;
  std::vector<std::size_t> slots;  // by source
  slots.reserve(sources.size());
  for (std::size_t part = 0; part < parts; ++part)
    for (std::size_t i = 0; i < sizes[part]; ++i) slots.push_back(first_of(*layout, part) + i);
  const auto moved = [&](const Buffer<float>& before) {
    Buffer<float> to(size + tail);
    for (std::size_t i = 0; i < sources.size(); ++i)
      for (int row = 0; row < kGaussianRows; ++row)
        to[gaussian_slot(slots[i], row)] = before[gaussian_slot(sources[i].from, row)];
    std::copy_n(before.data() + old_size, tail, to.data() + size);
    return to;
  };
  // One by one, so that no more than one of them is there twice.
  adam->second_moment = moved(adam->second_moment);
  adam->first_moment = moved(adam->first_moment);
  Buffer<float>& first = adam->first_moment;
  Buffer<float> to = moved(*numbers);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const std::size_t slot = slots[i];
    first[gaussian_slot(slot, kDistanceRow)] = 0;
    if (sources[i].half != 0) {
      const int axis = longest_axis(p, sources[i].from);
      const std::array<float, 3> along = axis_of(p, sources[i].from, axis);
      for (int k = 0; k < 3; ++k) {
        to[gaussian_slot(slot, kPositionRow + k)] +=
            kChildOffset * static_cast<float>(sources[i].half) * along[k];
        to[gaussian_slot(slot, kLogScaleRow + k)] +=
            std::log(k == axis ? kChildScale : kChildOtherScale);
      }
      if (sources[i].half < 0)
        for (int row = 0; row < kDistanceRow; ++row) first[gaussian_slot(slot, row)] = 0;
    }
  }
  for (std::size_t part = 0; part < parts; ++part)
    clear_unused(first_of(*layout, part) + sizes[part], first_of(*layout, part + 1), to.data());
  *numbers = std::move(to);
}

}  // namespace redrive
