// SPDX-License-Identifier: Apache-2.0
// A device that computes nothing and has no memory, but counts what the stages would take of a
// GPU's (Backend::counting), as cuda_device.h takes it. So memory needs follow from the stages
// themselves instead of from a list beside them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "redrive/kernels/backend.h"
#include "redrive/kernels/device/arena.h"
#include "redrive/kernels/device/resident_buffers.h"

namespace redrive::kernels {

/// Addresses without memory behind them.
class CountedAllocations {
 public:
  explicit CountedAllocations(MemoryCount* count) : count_(count) {}

  void* allocate(std::size_t bytes) {
    constexpr std::uintptr_t kPage = 4096;
    auto* const place = reinterpret_cast<void*>(next_);
    next_ += (bytes / kPage + 1) * kPage;
    bytes_[place] = bytes;
    count_->now += bytes;
    count_->most = std::max(count_->most, count_->now);
    return place;
  }
  void release(void* place) {
    const auto block = bytes_.find(place);
    count_->now -= block->second;
    bytes_.erase(block);
  }

 private:
  MemoryCount* count_;
  std::map<void*, std::size_t> bytes_;
  std::uintptr_t next_ = 1 << 20;
};

/// samples, grid_samples: the counted device's kMaxSamplesPerPass and kMaxGridSamplesPerPass.
template <std::size_t samples, std::size_t grid_samples>
class CountingDevice {
 public:
  static constexpr std::size_t kMaxSamplesPerPass = samples, kMaxGridSamplesPerPass = grid_samples;

  CountingDevice(MemoryCount* count, bool has_tensor_cores)
      : count_(count),
        has_tensor_cores_(has_tensor_cores),
        places_(std::make_shared<CountedAllocations>(count)) {}
  bool has_tensor_cores() const { return has_tensor_cores_; }
  std::optional<std::string> description() const { return std::nullopt; }
  std::optional<std::uint64_t> free_memory() const { return std::nullopt; }

  void begin() { memory_.begin(); }
  void* take(std::size_t bytes) { return memory_.take(bytes); }
  std::shared_ptr<void> hold(std::size_t bytes) {
    return {places_->allocate(bytes), [places = places_](void* place) { places->release(place); }};
  }
  void spoil(std::span<std::byte>) {}
  void wait() {}
  void to_device(void*, const void*, std::size_t) {}
  void to_host(void* host, const void* device, std::size_t bytes) {
    std::memset(host, 0, bytes);
    if (device == live_ && bytes == sizeof live_count_) std::memcpy(host, &live_count_, bytes);
  }
  void exclusive_sum(std::size_t n, const std::uint32_t*, std::uint32_t* sums) {
    constexpr std::size_t kNumbersOfABlock = 256,
                          kState = 16;  // of CUB's scan, and rather more than it takes
    take(n / kNumbersOfABlock * kState + 4096);
    live_ = sums + n - 1;  // Stage::choose
    live_count_ = static_cast<std::uint32_t>(n > 1 && !count_->all_active ? n - 2 : n - 1);
  }
  template <class Functor>
  void for_each(std::size_t, const Functor&) {}
  template <class Functor>
  void for_each_warp(std::size_t, const Functor&) {}

  ResidentBuffers kept;

 private:
  struct Source {
    CountedAllocations* places;
    void* allocate(std::size_t bytes) const { return places->allocate(bytes); }
    void release(void* place) const { places->release(place); }
  };

  MemoryCount* count_;
  bool has_tensor_cores_;
  std::shared_ptr<CountedAllocations> places_;
  Arena<Source> memory_{Source{places_.get()}};
  const void* live_ = nullptr;
  std::uint32_t live_count_ = 0;
};

}  // namespace redrive::kernels
