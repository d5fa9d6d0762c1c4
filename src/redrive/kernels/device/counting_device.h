// SPDX-License-Identifier: Apache-2.0
// A device that computes nothing and has no memory. It counts the memory that the stages would take
// on a GPU (Backend::counting), allocated as cuda_device.h does. So the memory estimate follows
// from the stages themselves.
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

/// Returns addresses without memory behind them.
class CountedAllocations {
 public:
  explicit CountedAllocations(MemoryCount* count) : count_(count) {}

  void* allocate(std::size_t bytes) {
    constexpr std::uintptr_t kPage = 4096;
    auto* const address = reinterpret_cast<void*>(next_);
    next_ += (bytes / kPage + 1) * kPage;
    bytes_[address] = bytes;
    count_->now += bytes;
    count_->most = std::max(count_->most, count_->now);
    return address;
  }
  void release(void* address) {
    const auto block = bytes_.find(address);
    count_->now -= block->second;
    bytes_.erase(block);
  }

 private:
  MemoryCount* count_;
  std::map<void*, std::size_t> bytes_;
  std::uintptr_t next_ = 1 << 20;
};

/// samples, grid_samples: kMaxSamplesPerPass and kMaxGridSamplesPerPass of the counted device.
template <std::size_t samples, std::size_t grid_samples>
class CountingDevice {
 public:
  static constexpr std::size_t kMaxSamplesPerPass = samples, kMaxGridSamplesPerPass = grid_samples;

  CountingDevice(MemoryCount* count, bool has_tensor_cores)
      : count_(count),
        has_tensor_cores_(has_tensor_cores),
        allocations_(std::make_shared<CountedAllocations>(count)) {}
  bool has_tensor_cores() const { return has_tensor_cores_; }
  std::optional<std::string> description() const { return std::nullopt; }
  std::optional<std::uint64_t> free_memory() const { return std::nullopt; }

  void begin() { memory_.begin(); }
  void* take(std::size_t bytes) { return memory_.take(bytes); }
  std::shared_ptr<void> hold(std::size_t bytes) {
    return {allocations_->allocate(bytes),
            [allocations = allocations_](void* address) { allocations->release(address); }};
  }
  void invalidate(std::span<std::byte>) {}
  void wait() {}
  void to_device(void*, const void*, std::size_t) {}
  void to_host(void* host, const void* device, std::size_t bytes) {
    std::memset(host, 0, bytes);
    if (device == last_sum_ && bytes == sizeof active_count_)
      std::memcpy(host, &active_count_, bytes);
  }
  void exclusive_sum(std::size_t n, const std::uint32_t*, std::uint32_t* sums) {
    constexpr std::size_t kNumbersOfABlock = 256,
                          kState = 16;  // upper bound of CUB's scan state
    take(n / kNumbersOfABlock * kState + 4096);
    last_sum_ = sums + n - 1;  // read by Stage::choose
    active_count_ = static_cast<std::uint32_t>(n > 1 && !count_->all_active ? n - 2 : n - 1);
  }
  template <class Functor>
  void for_each(std::size_t, const Functor&) {}
  template <class Functor>
  void for_each_warp(std::size_t, const Functor&) {}

  ResidentBuffers resident;

 private:
  struct Source {
    CountedAllocations* allocations;
    void* allocate(std::size_t bytes) const { return allocations->allocate(bytes); }
    void release(void* address) const { allocations->release(address); }
  };

  MemoryCount* count_;
  bool has_tensor_cores_;
  std::shared_ptr<CountedAllocations> allocations_;
  Arena<Source> memory_{Source{allocations_.get()}};
  const void* last_sum_ = nullptr;
  std::uint32_t active_count_ = 0;
};

}  // namespace redrive::kernels
