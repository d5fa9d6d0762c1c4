// SPDX-License-Identifier: Apache-2.0
// A Vulkan device for compute: its memory and its pipelines. Shaders get the address of a parameter
// block by push constants; there are no descriptors.
//
// Errors: DeviceError where the device, its driver or its memory fails.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "redrive/kernels/device_info.h"
#include "redrive/kernels/vulkan/shader.h"
#include "redrive/kernels/vulkan/vulkan_instance.h"

namespace redrive::kernels::vulkan {

class Device;

constexpr std::size_t kBufferAlignment = 16;

/// Memory of the device, of at least one byte. Any contents at first.
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(DeviceBuffer&& other) noexcept { *this = std::move(other); }
  DeviceBuffer& operator=(DeviceBuffer&& other) noexcept;
  ~DeviceBuffer();

  std::size_t bytes() const { return bytes_; }
  VkBuffer handle() const { return buffer_; }
  VkDeviceAddress address() const { return address_; }
  /// The host's view; null where it has none.
  void* mapped() const { return mapped_; }

 private:
  friend class Device;
  Device* device_ = nullptr;
  VkBuffer buffer_ = VK_NULL_HANDLE;
  VkDeviceMemory memory_ = VK_NULL_HANDLE;
  VkDeviceAddress address_ = 0;
  void* mapped_ = nullptr;
  std::size_t bytes_ = 0;
};

/// To use by one thread at a time.
class Device {
 public:
  /// which: as choose_device(). UsageError: there is no such device, or something is missing.
  static std::unique_ptr<Device> open(const std::string& which);
  ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  const DeviceInfo& info() const { return info_; }
  const Api& api() const { return api_; }
  VkDevice handle() const { return device_; }
  VkQueue queue() const { return queue_; }
  std::uint32_t family() const { return family_; }  ///< the queue's
  VkPipelineLayout layout() const { return layout_; }
  std::uint32_t groups_of_row() const { return groups_of_row_; }         ///< most groups along x
  double nanoseconds_per_tick() const { return nanoseconds_per_tick_; }  ///< counted by timestamps

  enum class Memory { kDevice, kUpload, kDownload };
  DeviceBuffer allocate(std::size_t bytes, Memory memory = Memory::kDevice);
  /// Compiles the shader the first time. constants: its specialization.
  VkPipeline pipeline(const Shader& shader, std::span<const std::uint32_t> constants);
  /// Throws DeviceError unless `result` is success.
  void check(VkResult result, const std::string& what);
  /// Throws DeviceError where an earlier check has failed: what was recorded then is lost.
  void check_unbroken() const;

 private:
  friend class DeviceBuffer;
  Device(std::shared_ptr<const Instance> instance, VkPhysicalDevice physical, DeviceInfo info);
  void create();

  std::shared_ptr<const Instance> instance_;
  Api api_;
  VkPhysicalDevice physical_ = VK_NULL_HANDLE;
  DeviceInfo info_;
  VkPhysicalDeviceMemoryProperties memory_types_{};
  VkDevice device_ = VK_NULL_HANDLE;
  VkQueue queue_ = VK_NULL_HANDLE;
  std::uint32_t family_ = 0, groups_of_row_ = 1;
  double nanoseconds_per_tick_ = 0;
  bool broken_ = false;
  VkPipelineLayout layout_ = VK_NULL_HANDLE;
  std::map<std::pair<const std::uint32_t*, std::vector<std::uint32_t>>, VkPipeline> pipelines_;
};

}  // namespace redrive::kernels::vulkan
