// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/vulkan_device.h"

#include <algorithm>

#include "redrive/base/error.h"

namespace redrive::kernels {

std::vector<DeviceInfo> list_vulkan_devices(std::string* reason) {
  const std::shared_ptr<const vulkan::Instance> instance = vulkan::make_instance();
  *reason = instance->obstacle;
  std::vector<DeviceInfo> devices;
  for (const VkPhysicalDevice device : instance->devices)
    devices.push_back(vulkan::describe_device(instance->api, device));
  return devices;
}

namespace vulkan {

DeviceBuffer& DeviceBuffer::operator=(DeviceBuffer&& other) noexcept {
  std::swap(device_, other.device_);
  std::swap(buffer_, other.buffer_);
  std::swap(memory_, other.memory_);
  std::swap(address_, other.address_);
  std::swap(mapped_, other.mapped_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

DeviceBuffer::~DeviceBuffer() {
  if (!device_) return;
  device_->api_.DestroyBuffer(device_->device_, buffer_, nullptr);
  device_->api_.FreeMemory(device_->device_, memory_, nullptr);
}

std::unique_ptr<Device> Device::open(const std::string& which) {
  std::shared_ptr<const Instance> instance = make_instance();
  if (!instance->obstacle.empty()) throw UsageError("--backend", "vulkan", instance->obstacle);
  std::vector<DeviceInfo> devices;
  for (const VkPhysicalDevice device : instance->devices)
    devices.push_back(describe_device(instance->api, device));
  const std::size_t i = choose_device(devices, which);
  const VkPhysicalDevice physical = instance->devices[i];
  std::unique_ptr<Device> device(new Device(std::move(instance), physical, devices[i]));
  device->create();
  return device;
}

void Device::check(VkResult result, const std::string& what) {
  if (result == VK_SUCCESS) return;
  broken_ = true;
  throw DeviceError(info_.name, what + ": " + result_text(result));
}

void Device::check_unbroken() const {
  if (broken_) throw DeviceError(info_.name, "has failed before");
}

Device::Device(std::shared_ptr<const Instance> instance, VkPhysicalDevice physical, DeviceInfo info)
    : instance_(std::move(instance)),
      api_(instance_->api),
      physical_(physical),
      info_(std::move(info)) {}

void Device::create() {
  api_.GetPhysicalDeviceMemoryProperties(physical_, &memory_types_);
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
  api_.GetPhysicalDeviceProperties2(physical_, &properties);
  groups_of_row_ = properties.properties.limits.maxComputeWorkGroupCount[0];
  nanoseconds_per_tick_ = static_cast<double>(properties.properties.limits.timestampPeriod);
  family_ = static_cast<std::uint32_t>(compute_family(api_, physical_));
  const float priority = 1;
  VkDeviceQueueCreateInfo queue{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
  queue.queueFamilyIndex = family_;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  VkPhysicalDeviceVulkan12Features features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
  features.bufferDeviceAddress = features.timelineSemaphore = VK_TRUE;
  VkDeviceCreateInfo device{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
  device.pNext = &features;
  device.queueCreateInfoCount = 1;
  device.pQueueCreateInfos = &queue;
  check(api_.CreateDevice(physical_, &device, nullptr, &device_), "vkCreateDevice");
#define REDRIVE_LOAD(name) set(&api_.name, api_.GetDeviceProcAddr(device_, "vk" #name));
  REDRIVE_VULKAN_DEVICE(REDRIVE_LOAD)
#undef REDRIVE_LOAD
  if (wrap_api) wrap_api(&api_);
  api_.GetDeviceQueue(device_, family_, 0, &queue_);
  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, kPushBytes};
  VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
  layout.pushConstantRangeCount = 1;
  layout.pPushConstantRanges = &range;
  check(api_.CreatePipelineLayout(device_, &layout, nullptr, &layout_), "vkCreatePipelineLayout");
}

Device::~Device() {
  if (!device_) return;
  for (const auto& [key, pipeline] : pipelines_) api_.DestroyPipeline(device_, pipeline, nullptr);
  if (layout_) api_.DestroyPipelineLayout(device_, layout_, nullptr);
  api_.DestroyDevice(device_, nullptr);
}

DeviceBuffer Device::allocate(std::size_t bytes, Memory memory) {
  DeviceBuffer made;
  made.device_ = this;
  made.bytes_ = (std::max<std::size_t>(bytes, 1) + kBufferAlignment - 1) / kBufferAlignment *
                kBufferAlignment;
  VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
  info.size = made.bytes_;
  info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT |
               VK_BUFFER_USAGE_TRANSFER_DST_BIT | VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT |
               VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
  check(api_.CreateBuffer(device_, &info, nullptr, &made.buffer_), "vkCreateBuffer");
  VkMemoryRequirements needs;
  api_.GetBufferMemoryRequirements(device_, made.buffer_, &needs);
  constexpr VkMemoryPropertyFlags kHost =
      VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
  const VkMemoryPropertyFlags must =
      memory == Memory::kDevice ? VkMemoryPropertyFlags{VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT}
                                : kHost;
  const VkMemoryPropertyFlags wanted =
      memory == Memory::kDownload ? VkMemoryPropertyFlags{VK_MEMORY_PROPERTY_HOST_CACHED_BIT} : 0;
  int best = -1, best_score = -1;
  for (std::uint32_t i = 0; i < memory_types_.memoryTypeCount; ++i) {
    const VkMemoryPropertyFlags flags = memory_types_.memoryTypes[i].propertyFlags;
    if (!(needs.memoryTypeBits >> i & 1) || (flags & must) != must) continue;
    // What the host reads and writes lies in its own memory where there is a choice.
    const bool own = !(flags & VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
    const int score = 2 * ((flags & wanted) == wanted) + (memory != Memory::kDevice && own);
    if (score > best_score) {
      best = static_cast<int>(i);
      best_score = score;
    }
  }
  if (best < 0) throw DeviceError(info_.name, "has no memory of the kind that is needed");
  VkMemoryAllocateFlagsInfo flags{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
  flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
  VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
  allocate.pNext = &flags;
  allocate.allocationSize = needs.size;
  allocate.memoryTypeIndex = static_cast<std::uint32_t>(best);
  check(api_.AllocateMemory(device_, &allocate, nullptr, &made.memory_),
        "memory of " + std::to_string(made.bytes_) + " bytes");
  check(api_.BindBufferMemory(device_, made.buffer_, made.memory_, 0), "vkBindBufferMemory");
  if (memory != Memory::kDevice)
    check(api_.MapMemory(device_, made.memory_, 0, VK_WHOLE_SIZE, 0, &made.mapped_), "vkMapMemory");
  VkBufferDeviceAddressInfo address{VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
  address.buffer = made.buffer_;
  made.address_ = api_.GetBufferDeviceAddress(device_, &address);
  return made;
}

VkPipeline Device::pipeline(const Shader& shader, std::span<const std::uint32_t> constants) {
  VkPipeline& pipeline = pipelines_[{
      shader.words.data(), std::vector<std::uint32_t>(constants.begin(), constants.end())}];
  if (pipeline) return pipeline;
  VkShaderModuleCreateInfo code{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
  code.codeSize = shader.words.size_bytes();
  code.pCode = shader.words.data();
  VkShaderModule module = VK_NULL_HANDLE;
  check(api_.CreateShaderModule(device_, &code, nullptr, &module), std::string(shader.name));
  std::vector<VkSpecializationMapEntry> entries;
  for (std::uint32_t i = 0; i < constants.size(); ++i) entries.push_back({i, 4 * i, 4});
  const VkSpecializationInfo special{static_cast<std::uint32_t>(entries.size()), entries.data(),
                                     constants.size_bytes(), constants.data()};
  VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
  info.stage = {VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO};
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.module = module;
  info.stage.pName = "main";
  info.stage.pSpecializationInfo = &special;
  info.layout = layout_;
  const VkResult result =
      api_.CreateComputePipelines(device_, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline);
  api_.DestroyShaderModule(device_, module, nullptr);
  check(result, std::string(shader.name));
  return pipeline;
}

}  // namespace vulkan
}  // namespace redrive::kernels
