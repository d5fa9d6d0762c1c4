// SPDX-License-Identifier: Apache-2.0
// One call of a stage on a device: its spans copied there and back, and what it does there. A Device (loop_device.h, cuda_device.h) has
//   begin()                       memory that was taken before is free again
//   take(bytes)                   memory of the device, whatever is in it, aligned for any number
//   to_device, to_host            copies; to_host waits until it is there
//   for_each(n, functor)          functor(i) for i in [0, n), in any order and at once; what it needs lies in it or on the device
//   has_tensor_cores()            whether it runs the warps of mma.h
//   for_each_warp(n, functor)     functor(i) by a warp each (mma.h)
//   hold(bytes), kept             memory that stays as long as its handle lives, and what of the host's numbers lies in such
//   spoil(host)                   is told that the host's copy of kept numbers is out of date
//   kSamplesAtOnce                rows that a network's activations are kept for; kGridSamplesAtOnce: a fused one's (fused_grid_network.h)
#pragma once

#include <algorithm>
#include <numeric>
#include <span>
#include <vector>

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// The terms i = part, part + parts, ... of a sum.
template <class Term>
struct PartialSum {
  Term term;
  std::size_t n;
  std::span<double> parts;

  REDRIVE_HD void operator()(std::size_t part) const {
    double sum = 0;
    for (std::size_t i = part; i < n; i += parts.size()) sum += term(i);
    parts[part] = sum;
  }
};

/// As a GPU before compute capability 8.0: networks in fp32.
template <class Device>
class WithoutTensorCores : public Device {
 public:
  using Device::Device;
  bool has_tensor_cores() const { return false; }
};

template <class Device>
class Stage {
 public:
  explicit Stage(Device& device) : device_(device) { device.begin(); }
  Stage(const Stage&) = delete;
  Stage& operator=(const Stage&) = delete;

  /// The device's copy of what lies on the host, if it is not kept there anyway. No numbers: no memory.
  std::span<const float> in(std::span<const float> host) {
    if (const float* const kept = device_.kept.find(host)) return {kept, host.size()};
    return copy(host);
  }
  /// Memory of the device that finish() copies to `host`, or where these numbers are kept.
  std::span<float> out(std::span<float> host) {
    if (const auto kept = change_kept(host); !kept.empty()) return kept;
    return result(host, scratch<float>(host.size()));
  }
  /// Both.
  std::span<float> in_out(std::span<float> host) {
    if (const auto kept = change_kept(host); !kept.empty()) return kept;
    return result(host, copy(host));
  }
  template <class T>
  std::span<T> scratch(std::size_t n) {
    return n > 0 ? std::span<T>(static_cast<T*>(device_.take(n * sizeof(T))), n) : std::span<T>();
  }

  template <class Functor>
  void for_each(std::size_t n, const Functor& functor) {
    device_.for_each(n, functor);
  }

  template <class Functor>
  void for_each_warp(std::size_t n, const Functor& functor) {
    device_.for_each_warp(n, functor);
  }

  /// Sum of term(i) over i in [0, n), in an order that n alone decides: the same bits each time.
  template <class Term>
  double sum(std::size_t n, const Term& term) {
    constexpr std::size_t kParts = 4096;  // threads enough for a device, and few enough to be added up here
    const auto parts = scratch<double>(std::min(n, kParts));
    for_each(parts.size(), PartialSum<Term>{term, n, parts});
    std::vector<double> here(parts.size());
    device_.to_host(here.data(), parts.data(), parts.size_bytes());
    return std::accumulate(here.begin(), here.end(), 0.0);
  }

  /// Brings the results home: the last thing that a stage does.
  void finish() {
    for (const Result& result : results_)
      device_.to_host(result.host.data(), result.there.data(), result.host.size_bytes());
    results_.clear();
  }

 private:
  struct Result {
    std::span<float> host, there;
  };

  std::span<float> change_kept(std::span<float> host) {
    float* const kept = device_.kept.find(host);
    if (!kept) return {};
    device_.spoil(host);
    return {kept, host.size()};
  }
  std::span<float> result(std::span<float> host, std::span<float> there) {
    if (!host.empty()) results_.push_back({host, there});
    return there;
  }
  std::span<float> copy(std::span<const float> host) {
    const auto there = scratch<float>(host.size());
    if (!host.empty()) device_.to_device(there.data(), host.data(), host.size_bytes());
    return there;
  }

  Device& device_;
  std::vector<Result> results_;
};

}  // namespace redrive::kernels
