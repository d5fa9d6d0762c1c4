// SPDX-License-Identifier: Apache-2.0
// Replaces the functions of Vulkan by functions that count, fail, or watch over memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <tuple>
#include <type_traits>
#include <utility>

#include "redrive/kernels/vulkan/vulkan_api.h"

namespace redrive::kernels::vulkan::testing {

/// Of all devices that are opened while it exists. One at a time.
class WrappedApi {
 public:
  WrappedApi() {
    current_ = this;
    wrap_api = install;
  }
  ~WrappedApi() {
    wrap_api = nullptr;
    current_ = nullptr;
  }
  WrappedApi(const WrappedApi&) = delete;
  WrappedApi& operator=(const WrappedApi&) = delete;

  // ---- Failures
  int fail_at = 0;  ///< number of the call that fails, from 1, and each one after it; 0: none does
  VkResult failure = VK_ERROR_DEVICE_LOST;
  int calls = 0;  ///< calls so far that may fail
  int alive = 0;  ///< objects that were made and not destroyed

  std::uint32_t groups_of_row = 0;  ///< limit that devices state; 0: their own

  // ---- Memory
  /// Surrounds buffers with bytes that must keep their values, which are not a number: theirs at
  /// first, too.
  bool guards = false;
  int damaged_guards = 0;  ///< guards that were found to have changed, when memory was freed
  int checked_guards = 0;
  /// Bytes that the host does not see, now and at most.
  std::uint64_t device_bytes = 0, most_device_bytes = 0;
  std::uint64_t uploaded = 0;  ///< bytes copied from memory that the host sees

 private:
  static constexpr std::size_t kGuard = 4096;
  static constexpr int kNotANumber = 0xff;
  struct Memory {
    std::size_t bytes = 0;
    std::byte* mapped = nullptr;
    bool for_host = false;
  };

  template <auto Member>
  struct Wrapped;
  template <class R, class... A, R (*Api::*Member)(A...)>
  struct Wrapped<Member> {
    static inline R (*original)(A...) = nullptr;
    static inline int makes = 0;  ///< 1: it makes an object, -1: it destroys one

    static R call(A... arguments) {
      WrappedApi* const w = current_;
      if constexpr (std::is_same_v<R, VkResult>) {
        if (w && ++w->calls >= w->fail_at && w->fail_at > 0) {
          // What runs on a lost device has ended.
          if constexpr (std::is_same_v<decltype(Member), decltype(&Api::DeviceWaitIdle)>)
            original(arguments...);
          return w->failure;
        }
        const VkResult result = original(arguments...);
        if (w && result == VK_SUCCESS) w->alive += makes;
        return result;
      } else {
        if (w && makes < 0 && is_object(arguments...)) --w->alive;
        return original(arguments...);
      }
    }
    template <class... T>
    static bool is_object(T... values) {
      if constexpr (sizeof...(T) == 3) {
        const auto object = std::get<1>(std::tuple(values...));
        if constexpr (std::is_pointer_v<decltype(object)>) return object != nullptr;
      }
      return true;
    }
  };

  template <auto Member>
  static void wrap(Api* api, const char* name) {
    auto& entry = api->*Member;
    if (!entry || entry == Wrapped<Member>::call) return;
    const auto begins = [&](const char* with) {
      return std::strncmp(name, with, std::strlen(with)) == 0;
    };
    Wrapped<Member>::original = entry;
    Wrapped<Member>::makes = begins("Create") || begins("AllocateMemory") ? 1
                             : begins("Destroy") || begins("Free")        ? -1
                                                                          : 0;
    entry = Wrapped<Member>::call;
  }

  static void install(Api* api) {
    wrap<&Api::CreateDevice>(api, "CreateDevice");
    if (!api->CreateBuffer) {  // the instance's table
      if (api->GetPhysicalDeviceProperties2 != properties)
        instance_properties_ = std::exchange(api->GetPhysicalDeviceProperties2, properties);
      return;
    }
#define REDRIVE_WRAP(name) wrap<&Api::name>(api, #name);
    REDRIVE_VULKAN_DEVICE(REDRIVE_WRAP)
#undef REDRIVE_WRAP
    if (!current_) return;
    current_->inner_ = *api;
    api->GetBufferMemoryRequirements = requirements;
    api->AllocateMemory = allocate;
    api->BindBufferMemory = bind;
    api->MapMemory = map;
    api->FreeMemory = free;
    api->CmdCopyBuffer = copy;
  }

  static std::size_t guard() { return current_ && current_->guards ? kGuard : 0; }

  static void properties(VkPhysicalDevice device, VkPhysicalDeviceProperties2* out) {
    instance_properties_(device, out);
    if (current_ && current_->groups_of_row > 0)
      out->properties.limits.maxComputeWorkGroupCount[0] = current_->groups_of_row;
  }
  static void requirements(VkDevice device, VkBuffer buffer, VkMemoryRequirements* needs) {
    current_->inner_.GetBufferMemoryRequirements(device, buffer, needs);
    needs->size += 2 * guard();
  }
  static VkResult allocate(VkDevice device, const VkMemoryAllocateInfo* info,
                           const VkAllocationCallbacks* callbacks, VkDeviceMemory* memory) {
    WrappedApi& w = *current_;
    const VkResult result = w.inner_.AllocateMemory(device, info, callbacks, memory);
    if (result != VK_SUCCESS) return result;
    w.memory_[*memory].bytes = info->allocationSize;
    w.device_bytes += info->allocationSize;
    w.most_device_bytes = std::max(w.most_device_bytes, w.device_bytes);
    return result;
  }
  static VkResult bind(VkDevice device, VkBuffer buffer, VkDeviceMemory handle, VkDeviceSize) {
    WrappedApi& w = *current_;
    w.bound_[buffer] = handle;
    Memory& memory = w.memory_[handle];
    void* at = nullptr;
    // Memory that the host cannot see has no guards.
    if (guard() > 0 && Wrapped<&Api::MapMemory>::original(device, handle, 0, VK_WHOLE_SIZE, 0,
                                                          &at) == VK_SUCCESS) {
      memory.mapped = static_cast<std::byte*>(at);
      std::memset(at, kNotANumber, memory.bytes);
    }
    return w.inner_.BindBufferMemory(device, buffer, handle, guard());
  }
  static VkResult map(VkDevice device, VkDeviceMemory handle, VkDeviceSize, VkDeviceSize size,
                      VkMemoryMapFlags flags, void** at) {
    WrappedApi& w = *current_;
    Memory& memory = w.memory_[handle];
    if (!memory.for_host) w.device_bytes -= memory.bytes;
    memory.for_host = true;
    if (!memory.mapped) return w.inner_.MapMemory(device, handle, guard(), size, flags, at);
    *at = memory.mapped + kGuard;
    return VK_SUCCESS;
  }
  static void copy(VkCommandBuffer commands, VkBuffer from, VkBuffer to, std::uint32_t n,
                   const VkBufferCopy* regions) {
    WrappedApi& w = *current_;
    for (std::uint32_t i = 0; i < n && w.memory_[w.bound_[from]].for_host; ++i)
      w.uploaded += regions[i].size;
    w.inner_.CmdCopyBuffer(commands, from, to, n, regions);
  }
  static void free(VkDevice device, VkDeviceMemory handle, const VkAllocationCallbacks* callbacks) {
    WrappedApi& w = *current_;
    if (const auto found = w.memory_.find(handle); found != w.memory_.end()) {
      const Memory& memory = found->second;
      if (!memory.for_host) w.device_bytes -= memory.bytes;
      for (std::size_t at : {std::size_t{0}, memory.bytes - kGuard}) {
        if (!memory.mapped) break;
        ++w.checked_guards;
        for (std::size_t i = 0; i < kGuard; ++i)
          if (memory.mapped[at + i] != std::byte{kNotANumber}) {
            ++w.damaged_guards;
            break;
          }
      }
      w.memory_.erase(found);
    }
    w.inner_.FreeMemory(device, handle, callbacks);
  }

  static inline WrappedApi* current_ = nullptr;
  static inline PFN_vkGetPhysicalDeviceProperties2 instance_properties_ = nullptr;
  Api inner_;
  std::map<VkDeviceMemory, Memory> memory_;
  std::map<VkBuffer, VkDeviceMemory> bound_;
};

}  // namespace redrive::kernels::vulkan::testing
