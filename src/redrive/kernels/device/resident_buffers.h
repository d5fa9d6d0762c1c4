// SPDX-License-Identifier: Apache-2.0
// The host arrays that are resident on a device (backend.h, make_resident), and their addresses.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/error.h"

namespace redrive::kernels {

class ResidentBuffers {
 public:
  /// `there`: the device's memory; the array is resident as long as a handle on it lives.
  void add(std::span<const float> host, const std::shared_ptr<void>& there) {
    std::erase_if(all_, [](const Kept& kept) { return kept.there.expired(); });
    all_.push_back({std::as_bytes(host), there});
  }

  /// Returns the device's copy of `host`, a resident array or a part of one, of any type; null if
  /// it is not resident.
  void* find(std::span<const std::byte> host) const {
    for (const Kept& kept : all_) {
      if (host.empty() || !within(kept.host, host.data())) continue;
      const auto there = kept.there.lock();
      if (!there) continue;  // freed; another array may have its address
      const std::size_t first = host.data() - kept.host.data();
      REDRIVE_CHECK_OP(first + host.size(), <=, kept.host.size());
      return static_cast<std::byte*>(there.get()) + first;
    }
    return nullptr;
  }

 private:
  struct Kept {
    std::span<const std::byte> host;
    std::weak_ptr<void> there;
  };
  static bool within(std::span<const std::byte> all, const std::byte* place) {
    return std::less_equal<>()(all.data(), place) && std::less<>()(place, all.data() + all.size());
  }

  std::vector<Kept> all_;
};

}  // namespace redrive::kernels
