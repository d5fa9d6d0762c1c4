// SPDX-License-Identifier: Apache-2.0
// Stands in for a GPU where there is none: the kernels' functors one after the other, in memory of its own, so that the stages of
// device_backend.h are tested wherever there is a compiler. What a stage forgets to copy is not a number here, what it forgets to
// bring home stays behind, and of kept numbers the host has none until it fetches them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <numeric>
#include <span>
#include <vector>

#include "redrive/kernels/cuda/cuda_backend.h"
#include "redrive/kernels/cuda/kept_numbers.h"

namespace redrive::kernels {

class LoopDevice {
 public:
  static constexpr std::size_t kSamplesAtOnce = 300, kGridSamplesAtOnce = 300;  // few: batches of tests have more

  bool has_tensor_cores() const { return true; }  // by loops over a warp's lanes (mma.h)

  /// copies: is told of every copy, unless null.
  explicit LoopDevice(DeviceCopies* copies = nullptr) : copies_(copies) {}

  void begin() { taken_.clear(); }
  void* take(std::size_t bytes) {  // each of its own size, for AddressSanitizer
    taken_.push_back(std::make_unique_for_overwrite<std::byte[]>(bytes));
    return std::memset(taken_.back().get(), 0xFF, bytes);  // NaN
  }
  std::shared_ptr<void> hold(std::size_t bytes) { return std::make_shared_for_overwrite<std::byte[]>(bytes); }
  void spoil(std::span<std::byte> host) { std::memset(host.data(), 0xFF, host.size()); }  // NaN
  void wait() {}
  void to_device(void* device, const void* host, std::size_t bytes) {
    std::memcpy(device, host, bytes);
    if (copies_) copies_->to_device += bytes;
  }
  void to_host(void* host, const void* device, std::size_t bytes) {
    std::memcpy(host, device, bytes);
    if (copies_) copies_->to_host += bytes;
  }
  void sums_before(std::size_t n, const std::uint32_t* numbers, std::uint32_t* sums) {
    std::exclusive_scan(numbers, numbers + n, sums, std::uint32_t{0});
  }

  template <class Functor>
  void for_each(std::size_t n, const Functor& functor) {
    for (std::size_t i = 0; i < n; ++i) functor(i);
  }

  template <class Functor>
  void for_each_warp(std::size_t n, const Functor& functor) {
    for_each(n, functor);
  }

  KeptNumbers kept;

 private:
  DeviceCopies* copies_;
  std::vector<std::unique_ptr<std::byte[]>> taken_;
};

}  // namespace redrive::kernels
