// SPDX-License-Identifier: Apache-2.0
// The Vulkan devices of this machine.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace redrive::kernels::vulkan {

struct DeviceInfo {
  std::string name;
  std::string driver;                ///< name and version
  std::string api;                   ///< version of Vulkan, "1.3.230"
  bool is_cpu = false;               ///< a software device
  std::uint64_t memory = 0;          ///< largest heap of its own, bytes
  std::vector<std::string> missing;  ///< what the backend needs and the device lacks
};

/// The devices in the loader's order. `reason`: set where there are none.
std::vector<DeviceInfo> list_devices(std::string* reason);

/// Returns what hides an NVIDIA GPU from Vulkan, or "". has_nvidia: whether its driver is loaded;
/// capabilities: NVIDIA_DRIVER_CAPABILITIES of a container, or null.
std::string hidden_nvidia(bool has_nvidia, const char* capabilities,
                          const std::vector<DeviceInfo>& devices);

}  // namespace redrive::kernels::vulkan
