// SPDX-License-Identifier: Apache-2.0
// Working memory, taken in the same order in each step, so that nothing is allocated once every
// slot has reached its largest size.
#pragma once

#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "redrive/base/buffer.h"

namespace redrive {

constexpr int kMaxLossTerms = 8;

/// Losses and other sums of a step; 0 where no stage writes them.
struct StepSums {
  double opacity = 0;  ///< mean; 0 means a dead field
  double rgb_mse = 0;  ///< squared error of uniformly drawn colours, mean over channels: for PSNR
  double terms[kMaxLossTerms] = {};  ///< losses, which Trainee::loss_terms names
};

class Workspace {
 public:
  /// Starts a pass: slots are taken from the first one again.
  void begin() { next_ = 0; }

  /// Returns the next slot: n numbers of any value, valid until the next begin().
  template <class T = float>
  std::span<T> take(std::size_t n) {
    static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(float) == 0);
    if (next_ == places_.size()) places_.emplace_back();
    const std::size_t floats = n * (sizeof(T) / sizeof(float));
    return {reinterpret_cast<T*>(room_in(&places_[next_++], floats).data()), n};
  }

  /// Returns the one buffer that outlives begin(), valid until the next call.
  std::span<float> set_aside(std::size_t n) { return room_in(&aside_, n); }

  StepSums& sums() { return sums_; }

 private:
  static std::span<float> room_in(Buffer<float>* place, std::size_t n) {
    if (place->size() < n) *place = Buffer<float>(n);
    return place->span().first(n);
  }

  std::vector<Buffer<float>> places_;
  Buffer<float> aside_;
  StepSums sums_;
  std::size_t next_ = 0;
};

}  // namespace redrive
