// SPDX-License-Identifier: Apache-2.0
// Stands in for a GPU in tests: runs the functors of the kernels in loops, in memory of its own, so
// that the stages of device_backend.h are tested on every machine. Memory that a stage does not
// copy is NaN, results that it does not copy back are missing, and the host's copy of resident
// arrays is NaN until it is downloaded.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <numeric>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/resident_buffers.h"

namespace redrive::kernels {

class LoopDevice {
 public:
  static constexpr std::size_t kMaxSamplesPerPass = 300,
                               kMaxGridSamplesPerPass = 300;  // fewer than in the tests' batches
  static constexpr std::size_t kBenchmarkWarps = 1;

  bool has_tensor_cores() const { return true; }  // by loops over a warp's lanes (mma.h)

  /// copies: counts transfers; faults: injected failures; both may be null.
  explicit LoopDevice(TransferCounts* copies = nullptr, InjectedFaults* faults = nullptr)
      : copies_(copies), faults_(faults) {}

  std::optional<std::string> description() const { return std::nullopt; }
  std::optional<std::uint64_t> free_memory() const {
    return faults_ ? faults_->free_memory : std::optional<std::uint64_t>();
  }
  void begin() {
    taken_.clear();
    taken_bytes_ = 0;
  }
  void* take(std::size_t bytes) {  // separate blocks, for AddressSanitizer
    check_memory();
    taken_.push_back(std::make_unique_for_overwrite<std::byte[]>(bytes));
    taken_bytes_ += bytes;
    update_peak();
    return std::memset(taken_.back().get(), 0xFF, bytes);  // NaN
  }
  std::shared_ptr<void> hold(std::size_t bytes) {
    check_memory();
    *held_bytes_ += bytes;
    update_peak();
    return {new std::byte[bytes], [bytes, held = held_bytes_](void* memory) {
              delete[] static_cast<std::byte*>(memory);
              *held -= bytes;
            }};
  }
  void invalidate(std::span<std::byte> host) {
    std::memset(host.data(), 0xFF, host.size());
  }  // NaN
  void wait() {}
  void to_device(void* device, const void* host, std::size_t bytes) {
    std::memcpy(device, host, bytes);
    if (copies_) copies_->to_device += bytes;
  }
  void to_host(void* host, const void* device, std::size_t bytes) {
    check_failure();
    std::memcpy(host, device, bytes);
    if (!copies_) return;
    copies_->to_host += bytes;
    ++copies_->waits;
  }
  void exclusive_sum(std::size_t n, const std::uint32_t* numbers, std::uint32_t* sums) {
    std::exclusive_scan(numbers, numbers + n, sums, std::uint32_t{0});
  }

  template <class Functor>
  void for_each(std::size_t n, const Functor& functor) {
    count_launch();
    for (std::size_t i = 0; i < n; ++i) functor(i);
  }

  template <class Functor>
  void for_each_warp(std::size_t n, const Functor& functor) {
    count_launch();
    const bool skip_first = faults_ && faults_->skips_first_warp;
    for (std::size_t i = skip_first; i < n; ++i) functor(i);
  }

  ResidentBuffers resident;

 private:
  void check_failure() const {
    if (faults_ && faults_->kernel_launches == 0)
      throw DeviceError("the GPU failed, computing: injected fault");
  }
  void check_memory() {
    if (faults_ && faults_->allocations == 0)
      throw DeviceMemoryError("--backend", "loop", "the GPU has no memory left: injected fault");
    if (faults_ && faults_->allocations > 0) --faults_->allocations;
  }
  void count_launch() {
    check_failure();
    if (faults_ && faults_->kernel_launches > 0) --faults_->kernel_launches;
  }
  void update_peak() {
    if (copies_) copies_->peak_bytes = std::max(copies_->peak_bytes, *held_bytes_ + taken_bytes_);
  }

  TransferCounts* copies_;
  InjectedFaults* faults_;
  std::size_t taken_bytes_ = 0;
  std::shared_ptr<std::size_t> held_bytes_ =
      std::make_shared<std::size_t>(0);  // handles may outlive the device
  std::vector<std::unique_ptr<std::byte[]>> taken_;
};

}  // namespace redrive::kernels
