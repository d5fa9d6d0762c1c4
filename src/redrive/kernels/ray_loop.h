// SPDX-License-Identifier: Apache-2.0
// Loops over rays, by the threads of a pool. Their number changes no bit.
#pragma once

#include <cstddef>
#include <numeric>
#include <vector>

#include "redrive/base/parallel.h"

namespace redrive::kernels {

class RayLoop {
 public:
  /// pool: null for the caller's thread alone; else it must outlive the loop.
  explicit RayLoop(ThreadPool* pool) : pool_(pool) {}

  /// Calls body(i) for all i in [0, n).
  template <class Body>
  void for_each(std::size_t n, const Body& body) const {
    for_each_range(n, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) body(i);
    });
  }

  /// Returns the sum of term(i) over i in [0, n), by ranges of a fixed length and then over the
  /// ranges in order.
  template <class Term>
  double sum(std::size_t n, const Term& term) const {
    std::vector<double> sums((n + kRange - 1) / kRange);
    for_each_range(n, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) sums[begin / kRange] += term(i);
    });
    return std::accumulate(sums.begin(), sums.end(), 0.0);
  }

 private:
  static constexpr std::size_t kRange = 64;  // rays: some thousand samples

  template <class Body>
  void for_each_range(std::size_t n, const Body& body) const {
    if (pool_) return pool_->run_ranges(n, kRange, body);
    for (std::size_t begin = 0; begin < n; begin += kRange)
      body(begin, begin + kRange < n ? begin + kRange : n);
  }

  ThreadPool* pool_;
};

}  // namespace redrive::kernels
