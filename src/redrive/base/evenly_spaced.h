// SPDX-License-Identifier: Apache-2.0
// A few of many, as views to score or to take points from.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace redrive {

/// Returns `limit` of `size` indices, the middles of equal intervals; all of them where limit is 0
/// or at least size.
inline std::vector<std::size_t> evenly_spaced(std::size_t size, std::size_t limit) {
  const std::size_t count = limit == 0 ? size : std::min(limit, size);
  std::vector<std::size_t> chosen(count);
  for (std::size_t i = 0; i < count; ++i) chosen[i] = (2 * i + 1) * size / (2 * count);
  return chosen;
}

}  // namespace redrive
