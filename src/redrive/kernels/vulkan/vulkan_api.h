// SPDX-License-Identifier: Apache-2.0
// The functions of Vulkan 1.2 that compute needs, in a table that is filled at run time: redrive
// links no loader and runs where there is none.
#pragma once

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan.h>

namespace redrive::kernels::vulkan {

#define REDRIVE_VULKAN_INSTANCE(X)          \
  X(DestroyInstance)                        \
  X(EnumeratePhysicalDevices)               \
  X(EnumerateDeviceExtensionProperties)     \
  X(GetPhysicalDeviceMemoryProperties2)     \
  X(GetPhysicalDeviceProperties2)           \
  X(GetPhysicalDeviceFeatures2)             \
  X(GetPhysicalDeviceMemoryProperties)      \
  X(GetPhysicalDeviceQueueFamilyProperties) \
  X(CreateDevice)                           \
  X(GetDeviceProcAddr)
#define REDRIVE_VULKAN_DEVICE(X) \
  X(DestroyDevice)               \
  X(DeviceWaitIdle)              \
  X(GetDeviceQueue)              \
  X(QueueSubmit)                 \
  X(CreateSemaphore)             \
  X(DestroySemaphore)            \
  X(WaitSemaphores)              \
  X(CreateBuffer)                \
  X(DestroyBuffer)               \
  X(GetBufferMemoryRequirements) \
  X(GetBufferDeviceAddress)      \
  X(AllocateMemory)              \
  X(FreeMemory)                  \
  X(BindBufferMemory)            \
  X(MapMemory)                   \
  X(CreateShaderModule)          \
  X(DestroyShaderModule)         \
  X(CreatePipelineLayout)        \
  X(DestroyPipelineLayout)       \
  X(CreateComputePipelines)      \
  X(DestroyPipeline)             \
  X(CreateCommandPool)           \
  X(DestroyCommandPool)          \
  X(AllocateCommandBuffers)      \
  X(BeginCommandBuffer)          \
  X(EndCommandBuffer)            \
  X(ResetCommandPool)            \
  X(CmdBindPipeline)             \
  X(CmdPushConstants)            \
  X(CmdDispatch)                 \
  X(CmdDispatchIndirect)         \
  X(CmdPipelineBarrier)          \
  X(CmdFillBuffer)               \
  X(CmdCopyBuffer)               \
  X(CreateQueryPool)             \
  X(DestroyQueryPool)            \
  X(CmdResetQueryPool)           \
  X(CmdWriteTimestamp)           \
  X(GetQueryPoolResults)

struct Api {
  PFN_vkGetInstanceProcAddr GetInstanceProcAddr = nullptr;
  PFN_vkEnumerateInstanceVersion EnumerateInstanceVersion = nullptr;
  PFN_vkCreateInstance CreateInstance = nullptr;
#define REDRIVE_VULKAN_MEMBER(name) PFN_vk##name name = nullptr;
  REDRIVE_VULKAN_INSTANCE(REDRIVE_VULKAN_MEMBER)
  REDRIVE_VULKAN_DEVICE(REDRIVE_VULKAN_MEMBER)
#undef REDRIVE_VULKAN_MEMBER
};

template <class Function>
void set(Function* to, PFN_vkVoidFunction from) {
  *to = reinterpret_cast<Function>(from);
}

/// Called with each table once it is filled; null: not. Set by tests, which replace entries.
extern void (*wrap_api)(Api*);

}  // namespace redrive::kernels::vulkan
