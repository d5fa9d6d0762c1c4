// SPDX-License-Identifier: Apache-2.0
// One call of a stage on a device: copies its arguments to the device and its results back, and
// runs its functors. A Device (cuda_device.h, loop_device.h, counting_device.h) has
//
// - begin(): frees the memory that the last stage took.
// - take(bytes): returns device memory, uninitialised, aligned for any number.
// - hold(bytes): returns a handle on memory that stays as long as the handle lives.
// - resident: the host arrays that are resident in such memory (resident_buffers.h).
// - invalidate(host): is called when the host's copy of a resident array is out of date.
// - to_device, to_host: copies; to_host waits for the result. wait(): waits for everything.
// - for_each(n, functor): runs functor(i) for i in [0, n), in any order and concurrently. The
//   functor's data is in it or on the device.
// - has_tensor_cores(), for_each_warp(n, functor): functor(i) by one warp each (mma.h).
// - exclusive_sum(n, x, sums): sums[i] = x[0] + ... + x[i - 1], integers on the device.
// - description(), free_memory(): the device in words and its free bytes, where it has them.
// - kMaxSamplesPerPass, kMaxGridSamplesPerPass: number of samples whose activations a
//   layer-by-layer network and a fused one (fused_grid_network.h) keep at once.
// - kBenchmarkWarps: warps that keep the device busy while measure_ceilings.h measures it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/host_device.h"
#include "redrive/kernels/loss_term.h"

namespace redrive::kernels {

/// Sums the terms i = part, part + parts, ...
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

/// Returns a number as a term of a sum.
template <class T>
struct ValueTerm {
  std::span<const T> numbers;

  REDRIVE_HD double operator()(std::size_t i) const { return numbers[i]; }
};

struct AddLossTerms {
  LossTerm a, b;
  std::span<double> loss;

  REDRIVE_HD void operator()(std::size_t i) const { loss[i] = a.value() + b.value(); }
};

/// Marks chosen indices by 1, others and those past the end by 0.
template <class Choose>
struct MarkSelected {
  Choose choose;
  std::size_t n;
  std::span<std::uint32_t> marks;

  REDRIVE_HD void operator()(std::size_t i) const { marks[i] = i < n && choose(i) ? 1 : 0; }
};

/// Writes each marked index at the position given by the number of marks before it.
struct ListSelected {
  std::span<const std::uint32_t> marks, before;
  std::span<std::uint32_t> list;

  REDRIVE_HD void operator()(std::size_t i) const {
    if (marks[i] != 0) list[before[i]] = static_cast<std::uint32_t>(i);
  }
};

/// A device without tensor cores, whose networks are fp32.
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

  /// Returns the resident copy of `host`, or else a copy for this stage. Empty spans take no
  /// memory.
  template <class T>
  std::span<const T> in(std::span<T> host) {
    if (const void* const resident = device_.resident.find(std::as_bytes(host)))
      return {static_cast<const T*>(resident), host.size()};
    return copy(std::span<const T>(host));
  }
  std::span<const float> in(std::span<const float> host) { return in<const float>(host); }

  /// Returns the resident copy of `host`, or else memory that finish() copies to it.
  template <class T>
  std::span<T> out(std::span<T> host) {
    if (const auto resident = change_resident(host); !resident.empty()) return resident;
    return result(host, scratch<T>(host.size()));
  }
  std::span<float> out(std::span<float> host) { return out<float>(host); }

  /// Like out(), initialised with the values of `host`.
  std::span<float> in_out(std::span<float> host) {
    if (const auto resident = change_resident(host); !resident.empty()) return resident;
    return result(host, copy(std::span<const float>(host)));
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

  /// Sums term(i) over i in [0, n) in an order that n alone determines: the same bits each time.
  /// Returns one number on the device, none for n = 0.
  template <class Term>
  std::span<const double> reduce(std::size_t n, const Term& term) {
    constexpr std::size_t kParts = 4096, kFewParts = 64;  // first occupies a device, then few
    auto parts = scratch<double>(std::min(n, kParts));
    for_each(parts.size(), PartialSum<Term>{term, n, parts});
    while (parts.size() > 1) {
      const auto fewer = scratch<double>(parts.size() > kFewParts ? kFewParts : 1);
      for_each(fewer.size(), PartialSum<ValueTerm<double>>{{parts}, parts.size(), fewer});
      parts = fewer;
    }
    return parts;
  }
  /// Returns the sum on the host, which waits for it.
  template <class Term>
  double sum(std::size_t n, const Term& term) {
    const auto on_device = reduce(n, term);
    return on_device.empty() ? 0 : on_host(on_device[0]);
  }
  /// Writes the loss to the host or to its resident copy.
  void write_loss(const LossTerm& a, const LossTerm& b, double* loss) {
    for_each(1, AddLossTerms{a, b, out(std::span(loss, 1))});
  }
  void write_loss(const LossTerm& part, double* loss) { write_loss(part, {}, loss); }

  /// Writes all i in [0, n) that choose(i) accepts, ascending, to `list` on the device; returns how
  /// many.
  template <class Choose>
  std::size_t choose(std::size_t n, const Choose& choose, std::span<std::uint32_t> list) {
    const auto marks = scratch<std::uint32_t>(n + 1), before = scratch<std::uint32_t>(n + 1);
    for_each(n + 1, MarkSelected<Choose>{choose, n, marks});
    device_.exclusive_sum(n + 1, marks.data(), before.data());
    for_each(n, ListSelected{marks, before, list});
    return on_host(before[n]);
  }

  /// Copies the results to the host. The last call of a stage.
  void finish() {
    for (const Result& result : results_)
      device_.to_host(result.host.data(), result.on_device.data(), result.host.size_bytes());
    results_.clear();
  }

 private:
  struct Result {
    std::span<std::byte> host, on_device;
  };

  template <class T>
  std::span<T> change_resident(std::span<T> host) {
    void* const resident = device_.resident.find(std::as_bytes(host));
    if (!resident) return {};
    device_.invalidate(std::as_writable_bytes(host));
    return {static_cast<T*>(resident), host.size()};
  }
  template <class T>
  std::span<T> result(std::span<T> host, std::span<T> on_device) {
    if (!host.empty())
      results_.push_back({std::as_writable_bytes(host), std::as_writable_bytes(on_device)});
    return on_device;
  }
  template <class T>
  std::span<T> copy(std::span<const T> host) {
    const auto on_device = scratch<T>(host.size());
    if (!host.empty()) device_.to_device(on_device.data(), host.data(), host.size_bytes());
    return on_device;
  }
  /// Copies a number from the device.
  template <class T>
  T on_host(const T& on_device) {
    T here;
    device_.to_host(&here, &on_device, sizeof here);
    return here;
  }

  Device& device_;
  std::vector<Result> results_;
};

/// Executor of CommonGridStages and CommonNerfStages on a device.
template <class Device>
struct DeviceExecutor {
  Device* device = nullptr;
  Stage<Device> stage() const { return Stage<Device>(*device); }
};

}  // namespace redrive::kernels
