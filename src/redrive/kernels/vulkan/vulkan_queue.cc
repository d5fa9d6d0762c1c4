// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/vulkan_queue.h"

#include <algorithm>
#include <cstring>

#include "redrive/base/error.h"

namespace redrive::kernels::vulkan {
namespace {

constexpr std::uint32_t kStamps = 256;
constexpr std::size_t kChunk = std::size_t{16} << 20, kCopiedAtOnce = std::size_t{1} << 20;

}  // namespace

std::unique_ptr<Queue> Queue::make(Device* device, ThreadPool* pool) {
  std::unique_ptr<Queue> queue(new Queue(device, pool));
  queue->create();
  return queue;
}

void Queue::create() {
  VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
  pool.queueFamilyIndex = device_.family();
  device_.check(api_.CreateCommandPool(device_.handle(), &pool, nullptr, &commands_pool_),
                "vkCreateCommandPool");
  VkCommandBufferAllocateInfo commands{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
  commands.commandPool = commands_pool_;
  commands.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  commands.commandBufferCount = 2;
  device_.check(api_.AllocateCommandBuffers(device_.handle(), &commands, parts_),
                "vkAllocateCommandBuffers");
  VkSemaphoreTypeCreateInfo type{VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO};
  type.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
  VkSemaphoreCreateInfo semaphore{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO};
  semaphore.pNext = &type;
  device_.check(api_.CreateSemaphore(device_.handle(), &semaphore, nullptr, &timeline_),
                "vkCreateSemaphore");
  VkQueryPoolCreateInfo queries{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
  queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
  queries.queryCount = kStamps;
  device_.check(api_.CreateQueryPool(device_.handle(), &queries, nullptr, &queries_),
                "vkCreateQueryPool");
}

Queue::~Queue() {
  wait_idle();
  if (queries_) api_.DestroyQueryPool(device_.handle(), queries_, nullptr);
  if (timeline_) api_.DestroySemaphore(device_.handle(), timeline_, nullptr);
  if (commands_pool_) api_.DestroyCommandPool(device_.handle(), commands_pool_, nullptr);
}

void Queue::grow(DeviceBuffer* buffer, std::size_t bytes) {
  if (buffer->bytes() >= bytes && buffer->bytes() > 0) return;
  finish();                  // earlier commands may use it
  *buffer = DeviceBuffer();  // not both at once
  *buffer = device_.allocate(bytes + bytes / 8);
}

void Queue::begin_part(VkCommandBuffer part) {
  commands_ = part;
  VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  device_.check(api_.BeginCommandBuffer(commands_, &info), "vkBeginCommandBuffer");
}

void Queue::begin() {
  if (recording_) return;
  device_.check_unbroken();
  wait();
  device_.check(api_.ResetCommandPool(device_.handle(), commands_pool_, 0), "vkResetCommandPool");
  begin_part(parts_[0]);
  recording_ = true;
  names_.clear();
  if (stamps_) api_.CmdResetQueryPool(commands_, queries_, 0, kStamps);
  stamp("");
}

void Queue::stamp(const char* name) {
  if (!stamps_ || !recording_ || names_.size() == kStamps) return;
  api_.CmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_,
                         static_cast<std::uint32_t>(names_.size()));
  names_.push_back(name);
}

void Queue::barrier() {
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

void Queue::bind(const Shader& shader, std::span<const std::uint32_t> constants,
                 std::span<const std::byte> push) {
  begin();
  api_.CmdBindPipeline(commands_, VK_PIPELINE_BIND_POINT_COMPUTE,
                       device_.pipeline(shader, constants));
  api_.CmdPushConstants(commands_, device_.layout(), VK_SHADER_STAGE_COMPUTE_BIT, 0,
                        static_cast<std::uint32_t>(push.size()), push.data());
}

void Queue::dispatch(const Shader& shader, std::span<const std::uint32_t> constants,
                     std::span<const std::byte> push, std::uint32_t groups) {
  if (groups == 0) return;
  bind(shader, constants, push);
  const std::uint32_t across = std::min(groups, device_.groups_of_row());
  api_.CmdDispatch(commands_, across, (groups + across - 1) / across, 1);
  barrier();
}

void Queue::dispatch_indirect(const Shader& shader, std::span<const std::uint32_t> constants,
                              std::span<const std::byte> push, const DeviceBuffer& arguments,
                              std::size_t at) {
  bind(shader, constants, push);
  api_.CmdDispatchIndirect(commands_, arguments.handle(), at);
  barrier();
}

void Queue::fill(const DeviceBuffer& buffer, std::size_t bytes, std::uint32_t word) {
  begin();
  api_.CmdFillBuffer(commands_, buffer.handle(), 0, bytes, word);
  barrier();
}

Queue::Place Queue::stage(std::size_t bytes, Device::Memory memory) {
  Staging& staging = staging_[memory == Device::Memory::kDownload];
  const std::size_t size = (bytes + kBufferAlignment - 1) / kBufferAlignment * kBufferAlignment;
  while (staging.chunk < staging.chunks.size() &&
         staging.used + size > staging.chunks[staging.chunk].bytes()) {
    ++staging.chunk;
    staging.used = 0;
  }
  if (staging.chunk == staging.chunks.size()) {
    staging.chunks.push_back(device_.allocate(std::max(size, kChunk), memory));
    staging.used = 0;
  }
  const Place place{&staging.chunks[staging.chunk], staging.used};
  staging.used += size;
  return place;
}

void Queue::copy(void* to, const void* from, std::size_t bytes) {
  try {
    pool_.run_ranges(bytes, kCopiedAtOnce, [&](std::size_t begin, std::size_t end) {
      std::memcpy(static_cast<std::byte*>(to) + begin, static_cast<const std::byte*>(from) + begin,
                  end - begin);
    });
  } catch (const Interrupted&) {  // whoever uses the pool next is interrupted
    std::memcpy(to, from, bytes);
  }
}

void Queue::upload(const DeviceBuffer& to, std::size_t offset, const void* from,
                   std::size_t bytes) {
  if (bytes == 0) return;
  begin();
  const Place place = stage(bytes, Device::Memory::kUpload);
  copy(static_cast<std::byte*>(place.buffer->mapped()) + place.offset, from, bytes);
  const VkBufferCopy copy{place.offset, offset, bytes};
  api_.CmdCopyBuffer(commands_, place.buffer->handle(), to.handle(), 1, &copy);
  barrier();
}

void Queue::download(const DeviceBuffer& from, std::size_t offset, void* to, std::size_t bytes) {
  if (bytes == 0) return;
  begin();
  const Place place = stage(bytes, Device::Memory::kDownload);
  const VkBufferCopy copy{offset, place.offset, bytes};
  api_.CmdCopyBuffer(commands_, from.handle(), place.buffer->handle(), 1, &copy);
  downloads_.push_back({place, to, bytes, submitted_ + (commands_ == parts_[0] ? 1 : 2)});
}

void Queue::end_part() {
  // The host reads the results.
  VkMemoryBarrier host{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
  host.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
  host.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  api_.CmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0,
                          1, &host, 0, nullptr, 0, nullptr);
  device_.check(api_.EndCommandBuffer(commands_), "vkEndCommandBuffer");
}

void Queue::split() {
  begin();
  REDRIVE_CHECK(commands_ == parts_[0]);
  end_part();
  begin_part(parts_[1]);
}

void Queue::submit() {
  if (!recording_) return;
  recording_ = false;
  end_part();
  const std::uint32_t n = commands_ == parts_[0] ? 1 : 2;
  const std::uint64_t values[] = {submitted_ + 1, submitted_ + 2};
  VkTimelineSemaphoreSubmitInfo timelines[2];
  VkSubmitInfo infos[2];
  for (std::uint32_t part = 0; part < n; ++part) {
    timelines[part] = {VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO};
    timelines[part].signalSemaphoreValueCount = 1;
    timelines[part].pSignalSemaphoreValues = &values[part];
    infos[part] = {VK_STRUCTURE_TYPE_SUBMIT_INFO};
    infos[part].pNext = &timelines[part];
    infos[part].commandBufferCount = 1;
    infos[part].pCommandBuffers = &parts_[part];
    infos[part].signalSemaphoreCount = 1;
    infos[part].pSignalSemaphores = &timeline_;
  }
  device_.check(api_.QueueSubmit(device_.queue(), n, infos, VK_NULL_HANDLE), "vkQueueSubmit");
  submitted_ += n;
}

void Queue::wait_for(std::uint64_t value) {
  if (done_ >= value) return;
  VkSemaphoreWaitInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO};
  info.semaphoreCount = 1;
  info.pSemaphores = &timeline_;
  info.pValues = &value;
  const VkResult result = api_.WaitSemaphores(device_.handle(), &info, UINT64_MAX);
  done_ = result == VK_SUCCESS ? value : submitted_;  // a lost device is not waited for again
  device_.check(result, "vkWaitSemaphores");
  for (; !downloads_.empty() && downloads_.front().done <= value; downloads_.pop_front()) {
    const Pending& d = downloads_.front();
    copy(d.to, static_cast<const std::byte*>(d.from.buffer->mapped()) + d.from.offset, d.bytes);
  }
}

void Queue::wait() {
  if (done_ == submitted_) return;
  wait_for(submitted_);
  for (Staging& staging : staging_) staging.chunk = staging.used = 0;
  if (!stamps_ || names_.size() < 2) return;
  std::vector<std::uint64_t> ticks(names_.size());
  device_.check(api_.GetQueryPoolResults(device_.handle(), queries_, 0,
                                         static_cast<std::uint32_t>(ticks.size()), 8 * ticks.size(),
                                         ticks.data(), 8, VK_QUERY_RESULT_64_BIT),
                "vkGetQueryPoolResults");
  for (std::size_t i = 1; i < names_.size(); ++i)
    times_[names_[i]] +=
        1e-6 * device_.nanoseconds_per_tick() * static_cast<double>(ticks[i] - ticks[i - 1]);
}

void Queue::finish() {
  submit();
  wait();
}

}  // namespace redrive::kernels::vulkan
