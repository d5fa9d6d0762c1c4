// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/device_info.h"

#include <algorithm>

namespace redrive::kernels::vulkan {

#ifndef REDRIVE_VULKAN
std::vector<DeviceInfo> list_devices(std::string* reason) {
  *reason = "this build was made without Vulkan (docs/gpu.md)";
  return {};
}
#endif

std::string hidden_nvidia(bool has_nvidia, const char* capabilities,
                          const std::vector<DeviceInfo>& devices) {
  const auto is_nvidia = [](const DeviceInfo& device) {
    return device.driver.find("NVIDIA") != std::string::npos;
  };
  if (!has_nvidia || std::ranges::any_of(devices, is_nvidia)) return "";
  const std::string given = capabilities ? capabilities : "";
  if (capabilities && given.find("all") == std::string::npos &&
      given.find("graphics") == std::string::npos)
    return "an NVIDIA GPU is there, but this container has no Vulkan driver for it: start it with "
           "NVIDIA_DRIVER_CAPABILITIES=all or " +
           given + (given.empty() ? "" : ",") + "graphics";
  return "an NVIDIA GPU is there, but no Vulkan driver for it (Debian: nvidia-vulkan-icd; a "
         "container needs NVIDIA_DRIVER_CAPABILITIES=all)";
}

}  // namespace redrive::kernels::vulkan
