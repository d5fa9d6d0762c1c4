// SPDX-License-Identifier: Apache-2.0
// Merge sort on the threads of a pool.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "redrive/base/parallel.h"

namespace redrive {

/// Sorts `values`. Equal elements keep no order.
template <class T>
void sort_in_parallel(std::vector<T>* values, ThreadPool& pool) {
  constexpr std::size_t kChunk = 1 << 13;
  const std::size_t n = values->size();
  pool.run_ranges(n, kChunk, [&](std::size_t begin, std::size_t end) {
    std::sort(values->data() + begin, values->data() + end);
  });
  std::vector<T> merged(n > kChunk ? n : 0);
  for (std::size_t sorted = kChunk; sorted < n; sorted *= 2) {
    pool.run_ranges(n, 2 * sorted, [&](std::size_t begin, std::size_t end) {
      const T* const from = values->data();
      const std::size_t middle = std::min(begin + sorted, end);
      std::merge(from + begin, from + middle, from + middle, from + end, merged.data() + begin);
    });
    values->swap(merged);
  }
}

}  // namespace redrive
