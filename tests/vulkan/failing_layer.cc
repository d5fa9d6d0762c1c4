// SPDX-License-Identifier: Apache-2.0
// A layer of Vulkan that loses the device of any program: the submission of number
// REDRIVE_LOSES_DEVICE_AT and all that follow fail. For programs with one device.
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include <vulkan/vk_layer.h>

namespace {

PFN_vkGetInstanceProcAddr next_of_instance = nullptr;
PFN_vkGetDeviceProcAddr next_of_device = nullptr;
PFN_vkQueueSubmit next_submit = nullptr;
VkInstance the_instance = VK_NULL_HANDLE;

/// Returns the loader's link among the structures that create an instance or a device.
template <class Link>
Link* link_of(const void* first, VkStructureType type) {
  auto* at = static_cast<VkBaseOutStructure*>(const_cast<void*>(first));
  for (; at; at = at->pNext) {
    auto* const link = reinterpret_cast<Link*>(at);
    if (at->sType == type && link->function == VK_LAYER_LINK_INFO) return link;
  }
  std::abort();
}

VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info,
                                    const VkAllocationCallbacks* callbacks, VkInstance* instance) {
  auto* const link = link_of<VkLayerInstanceCreateInfo>(
      info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
  next_of_instance = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create =
      reinterpret_cast<PFN_vkCreateInstance>(next_of_instance(VK_NULL_HANDLE, "vkCreateInstance"));
  const VkResult result = create(info, callbacks, instance);
  the_instance = *instance;
  return result;
}

VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                  const VkAllocationCallbacks* callbacks, VkDevice* device) {
  auto* const link =
      link_of<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
  next_of_device = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create =
      reinterpret_cast<PFN_vkCreateDevice>(next_of_instance(the_instance, "vkCreateDevice"));
  const VkResult result = create(physical, info, callbacks, device);
  if (result == VK_SUCCESS)
    next_submit = reinterpret_cast<PFN_vkQueueSubmit>(next_of_device(*device, "vkQueueSubmit"));
  return result;
}

VkResult VKAPI_CALL queue_submit(VkQueue queue, std::uint32_t n, const VkSubmitInfo* infos,
                                 VkFence fence) {
  static int submissions = 0;
  static const char* const at = std::getenv("REDRIVE_LOSES_DEVICE_AT");
  if (at && ++submissions >= std::atoi(at)) return VK_ERROR_DEVICE_LOST;
  return next_submit(queue, n, infos, fence);
}

PFN_vkVoidFunction own(const char* name) {
  if (std::strcmp(name, "vkCreateInstance") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(create_instance);
  if (std::strcmp(name, "vkCreateDevice") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(create_device);
  if (std::strcmp(name, "vkQueueSubmit") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(queue_submit);
  return nullptr;
}

PFN_vkVoidFunction VKAPI_CALL of_device(VkDevice device, const char* name) {
  const PFN_vkVoidFunction function = own(name);
  return function ? function : next_of_device(device, name);
}
PFN_vkVoidFunction VKAPI_CALL of_instance(VkInstance instance, const char* name) {
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(of_device);
  const PFN_vkVoidFunction function = own(name);
  return function ? function : next_of_instance(instance, name);
}

}  // namespace

extern "C" VK_LAYER_EXPORT VkResult VKAPI_CALL
vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface* interface) {
  interface->loaderLayerInterfaceVersion = 2;
  interface->pfnGetInstanceProcAddr = of_instance;
  interface->pfnGetDeviceProcAddr = of_device;
  interface->pfnGetPhysicalDeviceProcAddr = nullptr;
  return VK_SUCCESS;
}
