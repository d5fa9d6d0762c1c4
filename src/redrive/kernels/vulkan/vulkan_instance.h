// SPDX-License-Identifier: Apache-2.0
// The loader of Vulkan, and the devices that its drivers offer.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "redrive/kernels/device_info.h"
#include "redrive/kernels/vulkan/vulkan_api.h"

namespace redrive::kernels::vulkan {

constexpr std::size_t kPushBytes = 128;  ///< push constants of every shader, as a device needs

/// The loader and what it has found.
struct Instance {
  Api api;  ///< without the functions of a device
  VkInstance handle = VK_NULL_HANDLE;
  std::vector<VkPhysicalDevice> devices;
  std::string obstacle;  ///< why there are no devices

  Instance() = default;
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;
  ~Instance() {
    if (handle) api.DestroyInstance(handle, nullptr);
  }
};

/// Never null.
std::shared_ptr<const Instance> make_instance();

/// Returns the first queue family that computes; -1: none does.
int compute_family(const Api& api, VkPhysicalDevice device);

DeviceInfo describe_device(const Api& api, VkPhysicalDevice device);

/// Returns "device lost".
std::string result_text(VkResult result);

}  // namespace redrive::kernels::vulkan
