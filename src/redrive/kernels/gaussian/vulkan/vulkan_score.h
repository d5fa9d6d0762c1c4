// SPDX-License-Identifier: Apache-2.0
// Backend::score on a Vulkan device.
#pragma once

#include "redrive/kernels/backend.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels::vulkan {

/// Keeps its memory from image to image.
class VulkanScore {
 public:
  explicit VulkanScore(Queue* queue) : queue_(*queue) {}

  ImageScore score(const ImagePair& images);

 private:
  Queue& queue_;
  DeviceBuffer parameters_, rgb_, target_, mask_, planes_, sums_;
};

}  // namespace redrive::kernels::vulkan
