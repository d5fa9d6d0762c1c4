// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/densify_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr float kTransparent = -20;    // logit of unused lanes
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

/// Clears the lanes of the last block beyond n.
void clear_unused(std::size_t n, float* numbers) {
  for (std::size_t i = n; i < gaussian_blocks(n) * kGaussianBlock; ++i) {
    for (int row = 0; row < kGaussianRows; ++row) numbers[gaussian_slot(i, row)] = 0;
    numbers[gaussian_slot(i, kQuaternionRow)] = 1;
    numbers[gaussian_slot(i, kOpacityRow)] = kTransparent;
    numbers[gaussian_slot(i, kDistanceRow)] = 1;
  }
}

}  // namespace

void write_blocks(const GaussianList& list, Buffer<float>* numbers) {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order(list.size());
  for (std::size_t i = 0; i < order.size(); ++i)
    order[i] = {morton_key(&list.rows[i * std::size_t{kGaussianRows}]),
                static_cast<std::uint32_t>(i)};
  std::ranges::sort(order);
  for (std::size_t i = 0; i < order.size(); ++i)
    for (int row = 0; row < kGaussianRows; ++row)
      (*numbers)[gaussian_slot(i, row)] =
          list.rows[order[i].second * std::size_t{kGaussianRows} + row];
  clear_unused(order.size(), numbers->data());
}

std::size_t densify(const DensifyOptions& options, std::uint64_t key, std::size_t n,
                    std::size_t tail, Buffer<float>* numbers, AdamState* adam) {
  const float* const p = numbers->data();
  const float least = std::log(options.min_opacity / (1 - options.min_opacity));
  std::vector<std::uint32_t> alive;
  std::vector<std::pair<float, std::uint32_t>> candidates;  // drawn in ascending order
  for (std::size_t i = 0; i < n; ++i) {
    if (!(p[gaussian_slot(i, kOpacityRow)] >= least)) continue;
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
      sources.push_back({at, i, 0});
    } else {
      sources.push_back({at, i, 1});
      sources.push_back({at, i, -1});
    }
  }
  std::ranges::stable_sort(sources, {}, &Source::key);

  const std::size_t count = sources.size(), old_size = gaussian_blocks(n) * kBlockSize,
                    size = gaussian_blocks(count) * kBlockSize;
  const auto moved = [&](const Buffer<float>& before) {
    Buffer<float> to(size + tail);
    for (std::size_t i = 0; i < count; ++i)
      for (int row = 0; row < kGaussianRows; ++row)
        to[gaussian_slot(i, row)] = before[gaussian_slot(sources[i].from, row)];
    std::copy_n(before.data() + old_size, tail, to.data() + size);
    return to;
  };
  // One by one, so that no more than one of them is there twice.
  adam->second_moment = moved(adam->second_moment);
  adam->first_moment = moved(adam->first_moment);
  Buffer<float>& first = adam->first_moment;
  Buffer<float> to = moved(*numbers);
  for (std::size_t i = 0; i < count; ++i) {
    first[gaussian_slot(i, kDistanceRow)] = 0;
    if (sources[i].half != 0) {
      const int axis = longest_axis(p, sources[i].from);
      const std::array<float, 3> along = axis_of(p, sources[i].from, axis);
      for (int k = 0; k < 3; ++k) {
        to[gaussian_slot(i, kPositionRow + k)] +=
            kChildOffset * static_cast<float>(sources[i].half) * along[k];
        to[gaussian_slot(i, kLogScaleRow + k)] +=
            std::log(k == axis ? kChildScale : kChildOtherScale);
      }
      if (sources[i].half < 0)
        for (int row = 0; row < kDistanceRow; ++row) first[gaussian_slot(i, row)] = 0;
    }
  }
  clear_unused(count, to.data());
  *numbers = std::move(to);
  return count;
}

}  // namespace redrive
