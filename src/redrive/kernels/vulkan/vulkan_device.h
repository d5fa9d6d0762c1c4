// SPDX-License-Identifier: Apache-2.0
// A Vulkan device for compute: its memory, its pipelines and one command buffer at a time. Shaders
// get the address of a parameter block by push constants; there are no descriptors.
//
// Errors: DeviceError where the device, its driver or its memory fails.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "redrive/kernels/vulkan/device_info.h"
#include "redrive/kernels/vulkan/shader.h"
#include "redrive/kernels/vulkan/vulkan_api.h"

namespace redrive::kernels::vulkan {

class Device;

/// Memory of the device, of at least one byte. Any contents at first.
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  DeviceBuffer(DeviceBuffer&& other) noexcept { *this = std::move(other); }
  DeviceBuffer& operator=(DeviceBuffer&& other) noexcept;
  ~DeviceBuffer();

  std::size_t bytes() const { return bytes_; }
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
  /// which: "": the first device that is no software device and lacks nothing; else its number in
  /// list_devices() or a part of its name, in any case. UsageError: there is no such device, or
  /// something is missing.
  static std::unique_ptr<Device> open(const std::string& which);
  ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  const DeviceInfo& info() const { return info_; }

  enum class Memory { kDevice, kUpload, kDownload };
  DeviceBuffer allocate(std::size_t bytes, Memory memory = Memory::kDevice);
  /// Makes `buffer` hold at least `bytes`. Where it grows, what is recorded runs first, and its
  /// contents are lost.
  void grow(DeviceBuffer* buffer, std::size_t bytes);

  // ---- Recording. Commands run in their order; each sees what those before it have written.
  void dispatch(const Shader& shader, std::span<const std::uint32_t> constants,
                std::span<const std::byte> push, std::uint32_t groups);
  /// Number of groups: three words at `at` in `arguments`, which a shader has written.
  void dispatch_indirect(const Shader& shader, std::span<const std::uint32_t> constants,
                         std::span<const std::byte> push, const DeviceBuffer& arguments,
                         std::size_t at);
  void fill(const DeviceBuffer& buffer, std::size_t bytes, std::uint32_t word);
  /// Copies `bytes` of the host, now, to be written when the commands run.
  void upload(const DeviceBuffer& to, std::size_t offset, const void* from, std::size_t bytes);
  /// Writes to the host's `to` in finish().
  void download(const DeviceBuffer& from, std::size_t offset, void* to, std::size_t bytes);
  /// Names the time since the last stamp, where stamps are on.
  void stamp(const char* name);
  /// Begins to run what is recorded.
  void submit();
  /// submit(), then waits until all is done.
  void finish();

  /// Backend::take_stage_times.
  std::map<std::string, double> take_times() {
    stamps_ = true;
    return std::exchange(times_, {});
  }

 private:
  friend class DeviceBuffer;
  Device(std::shared_ptr<const struct Instance> instance, VkPhysicalDevice physical,
         DeviceInfo info);
  void check(VkResult result, const std::string& what) const;
  void begin();
  void wait();
  VkPipeline pipeline(const Shader& shader, std::span<const std::uint32_t> constants);
  void bind(const Shader& shader, std::span<const std::uint32_t> constants,
            std::span<const std::byte> push);
  void barrier();
  /// Returns a place in host memory that the device reads or writes, until the commands have run.
  struct Place {
    const DeviceBuffer* buffer;
    std::size_t offset;
  };
  Place stage(std::size_t bytes, Memory memory);

  std::shared_ptr<const struct Instance> instance_;
  Api api_;
  VkPhysicalDevice physical_ = VK_NULL_HANDLE;
  DeviceInfo info_;
  VkPhysicalDeviceMemoryProperties memory_types_{};
  double nanoseconds_per_tick_ = 0;
  VkDevice device_ = VK_NULL_HANDLE;
  VkQueue queue_ = VK_NULL_HANDLE;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  VkPipelineLayout layout_ = VK_NULL_HANDLE;
  VkSemaphore timeline_ = VK_NULL_HANDLE;
  VkQueryPool queries_ = VK_NULL_HANDLE;
  std::map<std::pair<const std::uint32_t*, std::vector<std::uint32_t>>, VkPipeline> pipelines_;

  bool recording_ = false, running_ = false, stamps_ = false;
  std::uint64_t submitted_ = 0;  ///< value of the timeline
  struct Staging {
    std::deque<DeviceBuffer> chunks;  ///< places point to them
    std::size_t chunk = 0, used = 0;
  } staging_[2];  ///< uploads, downloads
  struct Pending {
    Place from;
    void* to;
    std::size_t bytes;
  };
  std::vector<Pending> downloads_;
  std::vector<const char*> names_;  ///< names of stamps
  std::map<std::string, double> times_;
};

}  // namespace redrive::kernels::vulkan
