// SPDX-License-Identifier: Apache-2.0
// Devices that a backend computes on, beside the processor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace redrive::kernels {

struct DeviceInfo {
  std::string name;
  std::string driver;                ///< name and version
  std::string api;                   ///< version of Vulkan, "1.3.230"
  bool is_cpu = false;               ///< a software device
  std::uint64_t memory = 0;          ///< largest heap of its own, bytes
  std::uint64_t available = 0;       ///< bytes of it that this process may use
  std::vector<std::string> missing;  ///< what the backend needs and the device lacks
};

/// Devices of all backends, in the order of --device. reason: set where there are none.
std::vector<DeviceInfo> list_devices(std::string* reason);
/// Tests device i of them (self_test.h). Returns what fails, or "".
std::string device_fault(const DeviceInfo& device, std::size_t i);
/// The Vulkan devices, in the loader's order.
std::vector<DeviceInfo> list_vulkan_devices(std::string* reason);

/// Returns the index of the chosen device. which: "": the first one that is no software device and
/// lacks nothing; else its index or a part of its name, in any case. UsageError: there is no such
/// device, or something is missing.
std::size_t choose_device(const std::vector<DeviceInfo>& devices, const std::string& which);

/// Returns what choose_device() takes for each of n processes of a machine. which: "": each process
/// has the next GPU, in turn; one device: all share it; "a,b": one for each process. UsageError:
/// more processes than that.
std::vector<std::string> devices_of_processes(const std::vector<DeviceInfo>& devices,
                                              const std::string& which, int n);

/// "a, b"
std::string joined(const std::vector<std::string>& parts);

/// Returns what hides an NVIDIA GPU from Vulkan, or "". has_nvidia: whether its driver is loaded;
/// capabilities: NVIDIA_DRIVER_CAPABILITIES of a container, or null.
std::string hidden_nvidia(bool has_nvidia, const char* capabilities,
                          const std::vector<DeviceInfo>& devices);

}  // namespace redrive::kernels
