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
  /// memory: the device's copy. The array is resident as long as a handle on it lives.
  void add(std::span<const float> host, const std::shared_ptr<void>& memory) {
    std::erase_if(all_, [](const ResidentBuffer& resident) { return resident.memory.expired(); });
    all_.push_back({std::as_bytes(host), memory});
  }

  /// Returns the device's copy of `host`, a resident array or a part of one, of any type; null if
  /// it is not resident.
  void* find(std::span<const std::byte> host) const {
    for (const ResidentBuffer& resident : all_) {
      if (host.empty() || !within(resident.host, host.data())) continue;
      const auto memory = resident.memory.lock();
      if (!memory) continue;  // freed; another array may have its address
      const std::size_t first = host.data() - resident.host.data();
      REDRIVE_CHECK_OP(first + host.size(), <=, resident.host.size());
      return static_cast<std::byte*>(memory.get()) + first;
    }
    return nullptr;
  }

 private:
  struct ResidentBuffer {
    std::span<const std::byte> host;
    std::weak_ptr<void> memory;
  };
  static bool within(std::span<const std::byte> all, const std::byte* address) {
    return std::less_equal<>()(all.data(), address) &&
           std::less<>()(address, all.data() + all.size());
  }

  std::vector<ResidentBuffer> all_;
};

}  // namespace redrive::kernels
