// SPDX-License-Identifier: Apache-2.0
// Working memory, taken in the same order in each step, so that nothing is allocated once every
// slot has reached its largest size.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/backend.h"

namespace redrive {

constexpr int kMaxLossTerms = 8;

/// Sums that stages write on the device; the host downloads all of them once a step. Sums that no
/// stage writes are 0.
struct StepSums {
  double opacity = 0;  ///< mean; 0 means a dead field
  double rgb_mse = 0;  ///< squared error of colours drawn uniformly, mean over channels: for PSNR
  double not_finite = 0;             ///< gradients (Backend::not_finite)
  double terms[kMaxLossTerms] = {};  ///< losses, which Model::loss_terms names
};

class Workspace {
 public:
  /// Starts a pass: slots are taken from the first one on again, resident in the memory of
  /// `backend`. The host downloads what stages wrote and uploads what they read.
  void begin(kernels::Backend& backend) {
    backend_ = &backend;
    next_ = 0;
  }

  /// Returns the next slot: n numbers of any value, valid until the next begin().
  template <class T = float>
  std::span<T> take(std::size_t n) {
    return {reinterpret_cast<T*>(next<T>(n).data()), n};
  }

  /// Returns the one buffer that outlives begin(), valid until the next call.
  std::span<float> set_aside(std::size_t n) { return room_in(&aside_, n).span().first(n); }

  /// Returns the sums for stages to write; the host has them after fetch_sums(), so that it waits
  /// for the device once a step.
  StepSums& sums() {
    kernels::make_resident(*backend_, sums_);
    return sums_[0];
  }
  const StepSums& fetch_sums() {
    backend_->download(kernels::as_floats(std::as_const(sums_).span()));
    return sums_[0];
  }

  /// Returns numbers of the host where the backend reads them: uploaded once into a slot on a
  /// device, or `numbers` itself. Valid until the next begin(), and as long as `numbers` are.
  template <class T>
  std::span<const T> put(std::span<const T> numbers) {
    if (backend_->is_resident(kernels::as_floats(numbers))) return numbers;
    Buffer<float>& place = next<T>(numbers.size());
    if (!place.resident || numbers.empty()) return numbers;
    std::memcpy(place.data(), numbers.data(), numbers.size_bytes());
    backend_->upload(place.span().first(floats<T>(numbers.size())));
    return {reinterpret_cast<const T*>(place.data()), numbers.size()};
  }
  template <class T>
  std::span<const T> put(const std::vector<T>& numbers) {
    return put(std::span<const T>(numbers));
  }
  /// Downloads what stages wrote.
  void get(std::span<const float> numbers, std::span<float> out) const {
    backend_->download(numbers);
    std::ranges::copy(numbers, out.begin());
  }

 private:
  template <class T>
  static constexpr std::size_t floats(std::size_t n) {
    static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(float) == 0);
    return n * (sizeof(T) / sizeof(float));
  }
  template <class T>
  Buffer<float>& next(std::size_t n) {
    if (next_ == places_.size()) places_.emplace_back();
    return room_in(&places_[next_++], floats<T>(n));
  }
  Buffer<float>& room_in(Buffer<float>* place, std::size_t n) {
    if (place->size() < n) *place = Buffer<float>(n);
    kernels::make_resident(*backend_, *place);
    return *place;
  }

  kernels::Backend* backend_ = nullptr;
  std::vector<Buffer<float>> places_;
  Buffer<float> aside_;
  Buffer<StepSums> sums_{1};
  std::size_t next_ = 0;
};

}  // namespace redrive
