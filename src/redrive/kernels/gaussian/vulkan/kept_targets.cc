// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/kept_targets.h"

#include <algorithm>

namespace redrive::kernels::vulkan {
namespace {

constexpr std::uint64_t kBufferBytes = std::uint64_t{64} << 20;  // devices limit their number

std::size_t aligned(std::size_t bytes) {
  return (bytes + kBufferAlignment - 1) / kBufferAlignment * kBufferAlignment;
}

}  // namespace

bool KeptTargets::has_room(std::size_t bytes) {
  while (buffer_ < buffers_.size() && filled_ + bytes > buffers_[buffer_].bytes()) {
    ++buffer_;
    filled_ = 0;
  }
  if (buffer_ < buffers_.size()) return true;
  if (allocated_ + bytes > allowed_) return false;
  const std::uint64_t size = std::max<std::uint64_t>(
      bytes, std::min(kBufferBytes, (allowed_ - allocated_) / kBufferAlignment * kBufferAlignment));
  buffers_.push_back(queue_.allocate(size));
  allocated_ += size;
  filled_ = 0;
  return true;
}

const KeptTargets::Image* KeptTargets::find(const TargetWindow& target) {
  if (target.set == 0) return nullptr;
  if (target.set != set_) {
    images_.clear();
    buffer_ = filled_ = 0;
    set_ = target.set;
  }
  if (const auto found = images_.find(target.index); found != images_.end()) return &found->second;
  if (!has_room(aligned(target.rgb.size()) + aligned(target.alpha.size()) +
                aligned(target.used.size())))
    return nullptr;
  const auto copy = [&](std::span<const std::uint8_t> from) -> VkDeviceAddress {
    if (from.empty()) return 0;
    const std::size_t at = filled_;
    queue_.upload(buffers_[buffer_], at, from.data(), from.size());
    filled_ += aligned(from.size());
    return buffers_[buffer_].address() + at;
  };
  Image image;
  image.rgb = copy(target.rgb);
  image.alpha = copy(target.alpha);
  image.used = copy(target.used);
  return &(images_[target.index] = image);
}

}  // namespace redrive::kernels::vulkan
