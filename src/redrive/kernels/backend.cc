// SPDX-License-Identifier: Apache-2.0
// Defaults of Backend's stages, in loops on the host.
#include <algorithm>
#include <bit>
#include <cstdint>
#include <numeric>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/host_image_score.h"

namespace redrive::kernels {

void Backend::fill(std::span<float> numbers, float value) { std::ranges::fill(numbers, value); }

void Backend::mean(std::span<const float> numbers, double* mean) {
  REDRIVE_CHECK_OP(numbers.size(), >, 0u);
  *mean =
      std::accumulate(numbers.begin(), numbers.end(), 0.0) / static_cast<double>(numbers.size());
}

void Backend::not_finite(std::span<const float> numbers, double* count) {
  constexpr std::uint32_t kExponent = 0x7f800000;  // all ones: infinity or NaN
  std::uint32_t bad = 0;
  for (const float number : numbers)
    bad |= (std::bit_cast<std::uint32_t>(number) & kExponent) == kExponent;
  *count = bad;
}

void Backend::gather_pixels(const PixelSource& from, const PixelDraw& draw,
                            std::span<const float> errors, const GatheredRays& out) {
  check_gather_pixels(from, draw, errors.size(), out);
  redrive::gather_pixels(from, draw, errors, out);
}

void Backend::gather_returns(const LidarSource& from, const LidarDraw& draw,
                             const GatheredReturns& out) {
  check_gather_returns(from, out);
  redrive::gather_returns(from, draw, out);
}

void Backend::update_error_map(std::span<const std::uint32_t> cells, std::span<const float> squares,
                               std::span<float> errors) {
  redrive::update_error_map(cells, squares, errors);
}

ImageScore Backend::score(const ImagePair& images) {
  ThreadPool one(1);
  return score_on_host(images, one);
}

}  // namespace redrive::kernels
