// SPDX-License-Identifier: Apache-2.0
// Which of the host's numbers a device keeps (kernels.h, keep), and where.
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
  /// `there` is the device's memory; whoever has a handle on it decides for how long.
  void add(std::span<const float> host, const std::shared_ptr<void>& there) {
    std::erase_if(all_, [](const Kept& kept) { return kept.there.expired(); });
    all_.push_back({std::as_bytes(host), there});
  }

  /// The device's copy of `host`, numbers that are kept or a part of them, whatever their type;
  /// null if they are not.
  void* find(std::span<const std::byte> host) const {
    for (const Kept& kept : all_) {
      if (host.empty() || !within(kept.host, host.data())) continue;
      const auto there = kept.there.lock();
      if (!there) continue;  // numbers that are gone, others may stand in their place
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
