// SPDX-License-Identifier: Apache-2.0
// Runs a stage's functors on the host, with the interface of a device's stage (device/stage.h).
// Spans are used in place.
#pragma once

#include <cstddef>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/loss_term.h"

namespace redrive::kernels {

class HostStage {
 public:
  /// pool: null for the caller's thread alone. The number of threads changes no bit.
  explicit HostStage(ThreadPool* pool) : pool_(pool) {}
  HostStage(const HostStage&) = delete;
  HostStage& operator=(const HostStage&) = delete;

  template <class T>
  std::span<T> in(std::span<T> host) {
    return host;
  }
  template <class T>
  std::span<T> out(std::span<T> host) {
    return host;
  }
  template <class T>
  std::span<T> in_out(std::span<T> host) {
    return host;
  }

  template <class Functor>
  void for_each(std::size_t n, const Functor& functor) {
    for_each_range(n, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) functor(i);
    });
  }

  /// Returns the sum of term(i) over i in [0, n), by ranges of a fixed length and then over the
  /// ranges in order. Valid until the stage ends.
  template <class Term>
  std::span<const double> reduce(std::size_t n, const Term& term) {
    std::vector<double> sums((n + kRange - 1) / kRange);
    for_each_range(n, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) sums[begin / kRange] += term(i);
    });
    reduced_.push_back({std::accumulate(sums.begin(), sums.end(), 0.0)});
    return reduced_.back();
  }
  void write_loss(const LossTerm& a, const LossTerm& b, double* loss) {
    *loss = a.value() + b.value();
  }
  void write_loss(const LossTerm& term, double* loss) { write_loss(term, {}, loss); }

  /// Writes all i in [0, n) that choose(i) accepts, ascending, to `list`; returns how many.
  template <class Choose>
  std::size_t choose(std::size_t n, const Choose& choose, std::span<std::uint32_t> list) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < n; ++i)
      if (choose(i)) list[count++] = static_cast<std::uint32_t>(i);
    return count;
  }

  void finish() {}

 private:
  static constexpr std::size_t kRange = 64;  // rays: some thousand samples

  template <class Body>
  void for_each_range(std::size_t n, const Body& body) {
    if (pool_) return pool_->run_ranges(n, kRange, body);
    for (std::size_t begin = 0; begin < n; begin += kRange)
      body(begin, begin + kRange < n ? begin + kRange : n);
  }

  ThreadPool* const pool_;
  std::vector<std::vector<double>> reduced_;  // one number each
};

/// Executor of CommonGridStages and CommonNerfStages on the host; pool as in HostStage.
struct HostExecutor {
  ThreadPool* pool = nullptr;
  HostStage stage() const { return HostStage(pool); }
};

}  // namespace redrive::kernels
