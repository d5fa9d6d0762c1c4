// SPDX-License-Identifier: Apache-2.0
// Commands for a Vulkan device: recorded into a command buffer, or two of which the host waits for
// the first alone, and run when they are submitted.
//
// Errors: as vulkan_device.h.
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

#include "redrive/base/parallel.h"
#include "redrive/kernels/vulkan/vulkan_device.h"

namespace redrive::kernels::vulkan {

/// To use by one thread at a time. Buffers must outlive the commands that use them.
class Queue {
 public:
  /// The device and the pool must outlive the queue.
  static std::unique_ptr<Queue> make(Device* device, ThreadPool* pool);
  ~Queue();
  Queue(const Queue&) = delete;
  Queue& operator=(const Queue&) = delete;

  /// Makes `buffer` hold at least `bytes`. Where it grows, what is recorded runs first, and its
  /// contents are lost.
  void grow(DeviceBuffer* buffer, std::size_t bytes);
  /// Largest number of groups along x.
  std::uint32_t groups_of_row() const { return device_.groups_of_row(); }
  /// Makes a buffer that never grows.
  DeviceBuffer allocate(std::size_t bytes) { return device_.allocate(bytes); }

  // ---- Recording. Commands run in their order; each sees what those before it have written.
  /// Dispatches at least `groups` groups, in rows of groups_of_row() at most.
  void dispatch(const Shader& shader, std::span<const std::uint32_t> constants,
                std::span<const std::byte> push, std::uint32_t groups);
  /// Number of groups: three words at `at` in `arguments`, which a shader has written.
  void dispatch_indirect(const Shader& shader, std::span<const std::uint32_t> constants,
                         std::span<const std::byte> push, const DeviceBuffer& arguments,
                         std::size_t at);
  void fill(const DeviceBuffer& buffer, std::size_t bytes, std::uint32_t word);
  /// Copies `bytes` of the host, now, to be written when the commands run.
  void upload(const DeviceBuffer& to, std::size_t offset, const void* from, std::size_t bytes);
  /// Writes to the host's `to` in wait_first() or finish().
  void download(const DeviceBuffer& from, std::size_t offset, void* to, std::size_t bytes);
  /// Names the time since the last stamp, where stamps are on.
  void stamp(const char* name);
  /// Ends the first part of what is recorded: wait_first() waits for it alone. Once a submission.
  void split();
  /// Begins to run what is recorded.
  void submit();
  /// Waits until what was submitted before split() is done.
  void wait_first() { wait_for(submitted_ - 1); }
  /// submit(), then waits until all is done.
  void finish();
  /// Waits for what runs, and drops what is recorded and what was to be downloaded.
  void wait_idle() noexcept {
    api_.DeviceWaitIdle(device_.handle());
    recording_ = false;
    done_ = submitted_;
    downloads_.clear();
  }

  /// Backend::take_stage_times.
  std::map<std::string, double> take_times() {
    finish();
    stamps_ = true;
    return std::exchange(times_, {});
  }

 private:
  Queue(Device* device, ThreadPool* pool) : device_(*device), api_(device->api()), pool_(*pool) {}
  void create();
  void begin();
  void begin_part(VkCommandBuffer part);
  /// Ends a command buffer.
  void end_part();
  /// Waits until the timeline has this value.
  void wait_for(std::uint64_t value);
  void wait();
  void bind(const Shader& shader, std::span<const std::uint32_t> constants,
            std::span<const std::byte> push);
  void barrier();
  /// Returns a place in host memory that the device reads or writes, until the commands have run.
  struct Place {
    const DeviceBuffer* buffer;
    std::size_t offset;
  };
  Place stage(std::size_t bytes, Device::Memory memory);
  /// Copies as memcpy does, by all threads. Ctrl-C does not interrupt it.
  void copy(void* to, const void* from, std::size_t bytes);

  Device& device_;
  const Api& api_;
  ThreadPool& pool_;
  VkCommandPool commands_pool_ = VK_NULL_HANDLE;
  VkCommandBuffer parts_[2] = {}, commands_ = VK_NULL_HANDLE;  ///< commands_: the current part
  VkSemaphore timeline_ = VK_NULL_HANDLE;
  VkQueryPool queries_ = VK_NULL_HANDLE;

  bool recording_ = false, stamps_ = false;
  std::uint64_t submitted_ = 0, done_ = 0;  ///< values of the timeline; a part adds 1
  struct Staging {
    std::deque<DeviceBuffer> chunks;  ///< places point to them
    std::size_t chunk = 0, used = 0;
  } staging_[2];  ///< uploads, downloads
  struct Pending {
    Place from;
    void* to;
    std::size_t bytes;
    std::uint64_t done;  ///< value of the timeline
  };
  std::deque<Pending> downloads_;
  std::vector<const char*> names_;  ///< names of stamps
  std::map<std::string, double> times_;
};

}  // namespace redrive::kernels::vulkan
