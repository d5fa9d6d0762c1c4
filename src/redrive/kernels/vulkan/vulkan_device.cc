// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/vulkan_device.h"

#include <algorithm>
#include <cctype>
#include <cstring>

#include <dlfcn.h>

#include "redrive/base/error.h"

namespace redrive::kernels::vulkan {

/// The loader and what it has found.
struct Instance {
  Api api;
  VkInstance handle = VK_NULL_HANDLE;
  std::vector<VkPhysicalDevice> devices;
  std::string obstacle;  ///< why there are no devices

  Instance() = default;
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;
  ~Instance() {
    if (handle) api.DestroyInstance(handle, nullptr);
  }
};

namespace {

constexpr std::uint32_t kStamps = 256;
constexpr std::size_t kChunk = std::size_t{16} << 20, kAlignment = 16, kPushBytes = 128;

/// The loader stays open: drivers do not survive being unloaded.
void* loader() {
  static void* const library = dlopen("libvulkan.so.1", RTLD_NOW | RTLD_LOCAL);
  return library;
}

template <class Function>
void set(Function* to, PFN_vkVoidFunction from) {
  *to = reinterpret_cast<Function>(from);
}

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

/// Returns the first queue family that computes; -1: none does.
int compute_family(const Api& api, VkPhysicalDevice device) {
  std::uint32_t n = 0;
  api.GetPhysicalDeviceQueueFamilyProperties(device, &n, nullptr);
  std::vector<VkQueueFamilyProperties> families(n);
  api.GetPhysicalDeviceQueueFamilyProperties(device, &n, families.data());
  for (std::uint32_t i = 0; i < n; ++i)
    if (families[i].queueFlags & VK_QUEUE_COMPUTE_BIT) return static_cast<int>(i);
  return -1;
}

DeviceInfo describe_device(const Api& api, VkPhysicalDevice device) {
  VkPhysicalDeviceDriverProperties driver{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES};
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
  properties.pNext = &driver;
  api.GetPhysicalDeviceProperties2(device, &properties);
  const VkPhysicalDeviceProperties& p = properties.properties;
  DeviceInfo info;
  info.name = p.deviceName;
  info.driver = std::string(driver.driverName) + " " + driver.driverInfo;
  info.api = std::to_string(VK_API_VERSION_MAJOR(p.apiVersion)) + "." +
             std::to_string(VK_API_VERSION_MINOR(p.apiVersion)) + "." +
             std::to_string(VK_API_VERSION_PATCH(p.apiVersion));
  info.is_cpu = p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU;
  VkPhysicalDeviceMemoryProperties memory;
  api.GetPhysicalDeviceMemoryProperties(device, &memory);
  for (std::uint32_t i = 0; i < memory.memoryHeapCount; ++i)
    if (memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
      info.memory = std::max<std::uint64_t>(info.memory, memory.memoryHeaps[i].size);
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

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

std::string joined(const std::vector<std::string>& parts) {
  std::string all;
  for (const std::string& part : parts) all += (all.empty() ? "" : ", ") + part;
  return all;
}

/// Returns the index of the chosen device.
std::size_t choose(const std::vector<DeviceInfo>& devices, const std::string& which) {
  if (which.empty()) {
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (!devices[i].is_cpu && devices[i].missing.empty()) return i;
    throw UsageError("--backend", "vulkan",
                     "no GPU that it can use was found; \"redrive doctor\" lists the devices, and "
                     "--device NAME takes a software one");
  }
  const bool number = std::ranges::all_of(
      which, [](char c) { return std::isdigit(static_cast<unsigned char>(c)); });
  std::string names;
  for (std::size_t i = 0; i < devices.size(); ++i) {
    const bool found = number ? std::to_string(i) == which
                              : lower(devices[i].name).find(lower(which)) != std::string::npos;
    if (!found) {
      names += (i ? ", " : "") + std::to_string(i) + ": " + devices[i].name;
      continue;
    }
    if (!devices[i].missing.empty())
      throw UsageError("--device", which, devices[i].name + " lacks " + joined(devices[i].missing));
    return i;
  }
  throw UsageError("--device", which, "must be one of " + names);
}

}  // namespace

std::vector<DeviceInfo> list_devices(std::string* reason) {
  const std::shared_ptr<const Instance> instance = make_instance();
  *reason = instance->obstacle;
  std::vector<DeviceInfo> devices;
  for (const VkPhysicalDevice device : instance->devices)
    devices.push_back(describe_device(instance->api, device));
  return devices;
}

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
  const std::size_t i = choose(devices, which);
  const VkPhysicalDevice physical = instance->devices[i];
  return std::unique_ptr<Device>(new Device(std::move(instance), physical, devices[i]));
}

void Device::check(VkResult result, const std::string& what) const {
  if (result != VK_SUCCESS) throw DeviceError(info_.name, what + ": " + result_text(result));
}

Device::Device(std::shared_ptr<const Instance> instance, VkPhysicalDevice physical, DeviceInfo info)
    : instance_(std::move(instance)),
      api_(instance_->api),
      physical_(physical),
      info_(std::move(info)) {
  api_.GetPhysicalDeviceMemoryProperties(physical_, &memory_types_);
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
  api_.GetPhysicalDeviceProperties2(physical_, &properties);
  nanoseconds_per_tick_ = static_cast<double>(properties.properties.limits.timestampPeriod);
  const auto family = static_cast<std::uint32_t>(compute_family(api_, physical_));
  const float priority = 1;
  VkDeviceQueueCreateInfo queue{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
  queue.queueFamilyIndex = family;
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
  api_.GetDeviceQueue(device_, family, 0, &queue_);
  VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
  pool.queueFamilyIndex = family;
  check(api_.CreateCommandPool(device_, &pool, nullptr, &pool_), "vkCreateCommandPool");
  VkCommandBufferAllocateInfo commands{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
  commands.commandPool = pool_;
  commands.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  commands.commandBufferCount = 1;
  check(api_.AllocateCommandBuffers(device_, &commands, &commands_), "vkAllocateCommandBuffers");
  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, kPushBytes};
  VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
  layout.pushConstantRangeCount = 1;
  layout.pPushConstantRanges = &range;
  check(api_.CreatePipelineLayout(device_, &layout, nullptr, &layout_), "vkCreatePipelineLayout");
  VkSemaphoreTypeCreateInfo type{VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO};
  type.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
  VkSemaphoreCreateInfo semaphore{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO};
  semaphore.pNext = &type;
  check(api_.CreateSemaphore(device_, &semaphore, nullptr, &timeline_), "vkCreateSemaphore");
  VkQueryPoolCreateInfo queries{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
  queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
  queries.queryCount = kStamps;
  check(api_.CreateQueryPool(device_, &queries, nullptr, &queries_), "vkCreateQueryPool");
}

Device::~Device() {
  if (!device_) return;
  api_.DeviceWaitIdle(device_);
  for (Staging& staging : staging_) staging.chunks.clear();
  for (const auto& [key, pipeline] : pipelines_) api_.DestroyPipeline(device_, pipeline, nullptr);
  if (queries_) api_.DestroyQueryPool(device_, queries_, nullptr);
  if (timeline_) api_.DestroySemaphore(device_, timeline_, nullptr);
  if (layout_) api_.DestroyPipelineLayout(device_, layout_, nullptr);
  if (pool_) api_.DestroyCommandPool(device_, pool_, nullptr);
  api_.DestroyDevice(device_, nullptr);
}

DeviceBuffer Device::allocate(std::size_t bytes, Memory memory) {
  DeviceBuffer made;
  made.device_ = this;
  made.bytes_ = (std::max<std::size_t>(bytes, 1) + kAlignment - 1) / kAlignment * kAlignment;
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

void Device::grow(DeviceBuffer* buffer, std::size_t bytes) {
  if (buffer->bytes() >= bytes && buffer->bytes() > 0) return;
  finish();                  // earlier commands may use it
  *buffer = DeviceBuffer();  // not both at once
  *buffer = allocate(bytes + bytes / 8);
}

void Device::begin() {
  if (recording_) return;
  wait();
  check(api_.ResetCommandPool(device_, pool_, 0), "vkResetCommandPool");
  VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  check(api_.BeginCommandBuffer(commands_, &info), "vkBeginCommandBuffer");
  recording_ = true;
  names_.clear();
  if (stamps_) api_.CmdResetQueryPool(commands_, queries_, 0, kStamps);
  stamp("");
}

void Device::stamp(const char* name) {
  if (!stamps_ || !recording_ || names_.size() == kStamps) return;
  api_.CmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_,
                         static_cast<std::uint32_t>(names_.size()));
  names_.push_back(name);
}

void Device::barrier() {
  VkMemoryBarrier all{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
  all.srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
  all.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT |
                      VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT |
                      VK_ACCESS_INDIRECT_COMMAND_READ_BIT;
  constexpr VkPipelineStageFlags kStages = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT |
                                           VK_PIPELINE_STAGE_TRANSFER_BIT |
                                           VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT;
  api_.CmdPipelineBarrier(commands_, kStages, kStages, 0, 1, &all, 0, nullptr, 0, nullptr);
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

void Device::bind(const Shader& shader, std::span<const std::uint32_t> constants,
                  std::span<const std::byte> push) {
  begin();
  api_.CmdBindPipeline(commands_, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline(shader, constants));
  api_.CmdPushConstants(commands_, layout_, VK_SHADER_STAGE_COMPUTE_BIT, 0,
                        static_cast<std::uint32_t>(push.size()), push.data());
}

void Device::dispatch(const Shader& shader, std::span<const std::uint32_t> constants,
                      std::span<const std::byte> push, std::uint32_t groups) {
  if (groups == 0) return;
  bind(shader, constants, push);
  api_.CmdDispatch(commands_, groups, 1, 1);
  barrier();
}

void Device::dispatch_indirect(const Shader& shader, std::span<const std::uint32_t> constants,
                               std::span<const std::byte> push, const DeviceBuffer& arguments,
                               std::size_t at) {
  bind(shader, constants, push);
  api_.CmdDispatchIndirect(commands_, arguments.buffer_, at);
  barrier();
}

void Device::fill(const DeviceBuffer& buffer, std::size_t bytes, std::uint32_t word) {
  begin();
  api_.CmdFillBuffer(commands_, buffer.buffer_, 0, bytes, word);
  barrier();
}

Device::Place Device::stage(std::size_t bytes, Memory memory) {
  Staging& staging = staging_[memory == Memory::kDownload];
  const std::size_t size = (bytes + kAlignment - 1) / kAlignment * kAlignment;
  while (staging.chunk < staging.chunks.size() &&
         staging.used + size > staging.chunks[staging.chunk].bytes()) {
    ++staging.chunk;
    staging.used = 0;
  }
  if (staging.chunk == staging.chunks.size()) {
    staging.chunks.push_back(allocate(std::max(size, kChunk), memory));
    staging.used = 0;
  }
  const Place place{&staging.chunks[staging.chunk], staging.used};
  staging.used += size;
  return place;
}

void Device::upload(const DeviceBuffer& to, std::size_t offset, const void* from,
                    std::size_t bytes) {
  if (bytes == 0) return;
  begin();
  const Place place = stage(bytes, Memory::kUpload);
  std::memcpy(static_cast<std::byte*>(place.buffer->mapped_) + place.offset, from, bytes);
  const VkBufferCopy copy{place.offset, offset, bytes};
  api_.CmdCopyBuffer(commands_, place.buffer->buffer_, to.buffer_, 1, &copy);
  barrier();
}

void Device::download(const DeviceBuffer& from, std::size_t offset, void* to, std::size_t bytes) {
  if (bytes == 0) return;
  begin();
  const Place place = stage(bytes, Memory::kDownload);
  const VkBufferCopy copy{offset, place.offset, bytes};
  api_.CmdCopyBuffer(commands_, from.buffer_, place.buffer->buffer_, 1, &copy);
  downloads_.push_back({place, to, bytes});
}

void Device::submit() {
  if (!recording_) return;
  // What the host reads.
  VkMemoryBarrier host{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
  host.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
  host.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  api_.CmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0,
                          1, &host, 0, nullptr, 0, nullptr);
  recording_ = false;
  check(api_.EndCommandBuffer(commands_), "vkEndCommandBuffer");
  const std::uint64_t value = submitted_ + 1;
  VkTimelineSemaphoreSubmitInfo timeline{VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO};
  timeline.signalSemaphoreValueCount = 1;
  timeline.pSignalSemaphoreValues = &value;
  VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
  info.pNext = &timeline;
  info.commandBufferCount = 1;
  info.pCommandBuffers = &commands_;
  info.signalSemaphoreCount = 1;
  info.pSignalSemaphores = &timeline_;
  check(api_.QueueSubmit(queue_, 1, &info, VK_NULL_HANDLE), "vkQueueSubmit");
  submitted_ = value;
  running_ = true;
}

void Device::wait() {
  if (!running_) return;
  running_ = false;
  VkSemaphoreWaitInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO};
  info.semaphoreCount = 1;
  info.pSemaphores = &timeline_;
  info.pValues = &submitted_;
  check(api_.WaitSemaphores(device_, &info, UINT64_MAX), "vkWaitSemaphores");
  for (const Pending& d : downloads_)
    std::memcpy(d.to, static_cast<const std::byte*>(d.from.buffer->mapped_) + d.from.offset,
                d.bytes);
  downloads_.clear();
  for (Staging& staging : staging_) staging.chunk = staging.used = 0;
  if (!stamps_ || names_.size() < 2) return;
  std::vector<std::uint64_t> ticks(names_.size());
  check(api_.GetQueryPoolResults(device_, queries_, 0, static_cast<std::uint32_t>(ticks.size()),
                                 8 * ticks.size(), ticks.data(), 8, VK_QUERY_RESULT_64_BIT),
        "vkGetQueryPoolResults");
  for (std::size_t i = 1; i < names_.size(); ++i)
    times_[names_[i]] +=
        1e-6 * nanoseconds_per_tick_ * static_cast<double>(ticks[i] - ticks[i - 1]);
}

void Device::finish() {
  submit();
  wait();
}

}  // namespace redrive::kernels::vulkan
