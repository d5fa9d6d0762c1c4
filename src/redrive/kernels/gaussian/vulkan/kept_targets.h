// SPDX-License-Identifier: Apache-2.0
// Ground-truth images that stay on a Vulkan device (TargetWindow::set).
#pragma once

#include <deque>
#include <map>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels::vulkan {

class KeptTargets {
 public:
  explicit KeptTargets(Queue* queue) : queue_(*queue) {}

  /// GaussianStages::keep_targets.
  void allow(std::uint64_t bytes) { allowed_ = bytes; }
  /// Addresses of a whole image's bytes; 0: it has none.
  struct Image {
    VkDeviceAddress rgb = 0, alpha = 0, used = 0;
  };
  /// Returns the target's image, which is copied the first time; null: it is in no set, or there is
  /// no room.
  const Image* find(const TargetWindow& target);

 private:
  bool has_room(std::size_t bytes);

  Queue& queue_;
  std::uint64_t allowed_ = 0, allocated_ = 0, set_ = 0;
  std::map<int, Image> images_;
  std::deque<DeviceBuffer> buffers_;  ///< filled one after the other
  std::size_t buffer_ = 0, filled_ = 0;
};

}  // namespace redrive::kernels::vulkan
