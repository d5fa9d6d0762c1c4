// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/vulkan_instance.h"

#include <algorithm>
#include <cstring>

#include <dlfcn.h>

namespace redrive::kernels::vulkan {

void (*wrap_api)(Api*) = nullptr;

namespace {

/// The loader stays open: drivers do not survive being unloaded.
void* loader() {
  static void* const library = dlopen("libvulkan.so.1", RTLD_NOW | RTLD_LOCAL);
  return library;
}

}  // namespace

std::string result_text(VkResult result) {
  switch (result) {
    case VK_ERROR_OUT_OF_HOST_MEMORY: return "out of host memory";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "out of device memory";
    case VK_ERROR_DEVICE_LOST: return "device lost";
    case VK_ERROR_INITIALIZATION_FAILED: return "initialization failed";
    case VK_ERROR_INCOMPATIBLE_DRIVER: return "no driver found";
    default: return "VkResult " + std::to_string(static_cast<int>(result));
  }
}

std::shared_ptr<const Instance> make_instance() {
  auto instance = std::make_shared<Instance>();
  Api& api = instance->api;
  if (!loader()) {
    instance->obstacle = "there is no libvulkan.so.1 (Debian: libvulkan1)";
    return instance;
  }
  api.GetInstanceProcAddr =
      reinterpret_cast<PFN_vkGetInstanceProcAddr>(dlsym(loader(), "vkGetInstanceProcAddr"));
  const auto global = [&](const char* name) { return api.GetInstanceProcAddr(nullptr, name); };
  api.EnumerateInstanceVersion =
      reinterpret_cast<PFN_vkEnumerateInstanceVersion>(global("vkEnumerateInstanceVersion"));
  api.CreateInstance = reinterpret_cast<PFN_vkCreateInstance>(global("vkCreateInstance"));
  VkApplicationInfo application{VK_STRUCTURE_TYPE_APPLICATION_INFO};
  application.pApplicationName = "redrive";
  application.apiVersion = VK_API_VERSION_1_2;
  VkInstanceCreateInfo info{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
  info.pApplicationInfo = &application;
  if (const VkResult result = api.CreateInstance(&info, nullptr, &instance->handle);
      result != VK_SUCCESS) {
    instance->handle = VK_NULL_HANDLE;
    instance->obstacle = "vkCreateInstance: " + result_text(result);
    return instance;
  }
#define REDRIVE_LOAD(name) set(&api.name, api.GetInstanceProcAddr(instance->handle, "vk" #name));
  REDRIVE_VULKAN_INSTANCE(REDRIVE_LOAD)
#undef REDRIVE_LOAD
  if (wrap_api) wrap_api(&api);
  std::uint32_t n = 0;
  VkResult result = api.EnumeratePhysicalDevices(instance->handle, &n, nullptr);
  instance->devices.resize(n);
  if (result == VK_SUCCESS)
    result = api.EnumeratePhysicalDevices(instance->handle, &n, instance->devices.data());
  instance->devices.resize(n);
  if (result != VK_SUCCESS)
    instance->obstacle = "vkEnumeratePhysicalDevices: " + result_text(result);
  else if (n == 0)
    instance->obstacle = "no driver offers a device";
  return instance;
}

int compute_family(const Api& api, VkPhysicalDevice device) {
  std::uint32_t n = 0;
  api.GetPhysicalDeviceQueueFamilyProperties(device, &n, nullptr);
  std::vector<VkQueueFamilyProperties> families(n);
  api.GetPhysicalDeviceQueueFamilyProperties(device, &n, families.data());
  for (std::uint32_t i = 0; i < n; ++i)
    if (families[i].queueFlags & VK_QUEUE_COMPUTE_BIT) return static_cast<int>(i);
  return -1;
}

namespace {

bool has_extension(const Api& api, VkPhysicalDevice device, const char* name) {
  std::uint32_t n = 0;
  api.EnumerateDeviceExtensionProperties(device, nullptr, &n, nullptr);
  std::vector<VkExtensionProperties> extensions(n);
  api.EnumerateDeviceExtensionProperties(device, nullptr, &n, extensions.data());
  return std::ranges::any_of(extensions, [&](const VkExtensionProperties& extension) {
    return std::strcmp(extension.extensionName, name) == 0;
  });
}

/// Sets the memory of the largest heap, and what VK_EXT_memory_budget says is left of it.
void find_memory(const Api& api, VkPhysicalDevice device, DeviceInfo* info) {
  VkPhysicalDeviceMemoryBudgetPropertiesEXT budget{
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_BUDGET_PROPERTIES_EXT};
  VkPhysicalDeviceMemoryProperties2 memory{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_PROPERTIES_2};
  const bool has_budget = has_extension(api, device, VK_EXT_MEMORY_BUDGET_EXTENSION_NAME);
  if (has_budget) memory.pNext = &budget;
  api.GetPhysicalDeviceMemoryProperties2(device, &memory);
  const VkPhysicalDeviceMemoryProperties& heaps = memory.memoryProperties;
  for (std::uint32_t i = 0; i < heaps.memoryHeapCount; ++i) {
    const VkMemoryHeap& heap = heaps.memoryHeaps[i];
    if (!(heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) || heap.size <= info->memory) continue;
    info->memory = heap.size;
    info->available =
        has_budget ? std::min<std::uint64_t>(budget.heapBudget[i], heap.size) : heap.size;
  }
}

}  // namespace

DeviceInfo describe_device(const Api& api, VkPhysicalDevice device) {
  VkPhysicalDeviceDriverProperties driver{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES};
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
  properties.pNext = &driver;
  api.GetPhysicalDeviceProperties2(device, &properties);
  const VkPhysicalDeviceProperties& p = properties.properties;
  DeviceInfo info;
  info.name = p.deviceName;
  info.driver = std::string(driver.driverName) + " " +
                (driver.driverInfo[0] ? driver.driverInfo : std::to_string(p.driverVersion));
  info.api = std::to_string(VK_API_VERSION_MAJOR(p.apiVersion)) + "." +
             std::to_string(VK_API_VERSION_MINOR(p.apiVersion)) + "." +
             std::to_string(VK_API_VERSION_PATCH(p.apiVersion));
  info.is_cpu = p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU;
  find_memory(api, device, &info);
  const auto need = [&](bool there, const char* what) {
    if (!there) info.missing.emplace_back(what);
  };
  need(p.apiVersion >= VK_API_VERSION_1_2, "Vulkan 1.2");
  need(compute_family(api, device) >= 0, "a compute queue");
  need(p.limits.maxComputeSharedMemorySize >= 32768, "32 KiB of shared memory");
  need(p.limits.maxComputeWorkGroupInvocations >= 256, "groups of 256 threads");
  need(p.limits.maxPushConstantsSize >= kPushBytes, "128 bytes of push constants");
  if (p.apiVersion >= VK_API_VERSION_1_2) {
    VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
    VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2};
    features.pNext = &v12;
    api.GetPhysicalDeviceFeatures2(device, &features);
    need(v12.bufferDeviceAddress, "buffer device addresses");
    need(v12.timelineSemaphore, "timeline semaphores");
  }
  return info;
}

}  // namespace redrive::kernels::vulkan
