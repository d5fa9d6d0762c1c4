// SPDX-License-Identifier: Apache-2.0
// Sums and checks over arrays of numbers.
#pragma once

#include <bit>
#include <cstdint>
#include <numeric>
#include <span>

#include "redrive/base/error.h"

namespace redrive {

/// Returns the mean of at least one number, summed in double in order.
inline double mean_of(std::span<const float> numbers) {
  REDRIVE_CHECK_OP(numbers.size(), >, 0u);
  return std::accumulate(numbers.begin(), numbers.end(), 0.0) / static_cast<double>(numbers.size());
}

/// Whether no number is infinite or NaN.
inline bool all_finite(std::span<const float> numbers) {
  constexpr std::uint32_t kExponent = 0x7f800000;  // all ones: infinity or NaN
  std::uint32_t bad = 0;                           // no early exit, so that the loop is vectorised
  for (const float number : numbers)
    bad |= (std::bit_cast<std::uint32_t>(number) & kExponent) == kExponent;
  return bad == 0;
}

}  // namespace redrive
