// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/vulkan/vulkan_backend.h"

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_gaussian_stages.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_score.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {
namespace {

[[noreturn]] void refuse_rays() {
  throw UsageError("--backend", "vulkan",
                   "computes splats alone; methods nerf and grid need --backend cpu");
}

}  // namespace

VulkanBackend::VulkanBackend(std::unique_ptr<vulkan::Device> device, int threads)
    : Backend(threads),
      device_(std::move(device)),
      queue_(vulkan::Queue::make(device_.get(), &pool())),
      gaussians_(make_vulkan_gaussian_stages(queue_.get(), &pool())),
      score_(std::make_unique<vulkan::VulkanScore>(queue_.get())) {}

VulkanBackend::~VulkanBackend() = default;

ImageScore VulkanBackend::score(const ImagePair& images) { return score_->score(images); }

void VulkanBackend::composite_forward(int, const Samples&, std::span<const float>,
                                      std::span<const float>, const CompositeOut&) {
  refuse_rays();
}
void VulkanBackend::composite_backward(int, const Samples&, std::span<const float>,
                                       std::span<const float>, const CompositeOutGradient&,
                                       std::span<float>) {
  refuse_rays();
}
void VulkanBackend::photometric_loss(std::span<const float>, std::span<const float>,
                                     std::span<float>, double*) {
  refuse_rays();
}
void VulkanBackend::adam(const AdamStep&, std::span<float>, std::span<float>, std::span<float>,
                         std::span<float>) {
  refuse_rays();
}
NerfStages& VulkanBackend::nerf() { refuse_rays(); }
GridStages& VulkanBackend::grid() { refuse_rays(); }

std::unique_ptr<Backend> make_vulkan_backend(const std::string& device, int threads) {
  return std::make_unique<VulkanBackend>(vulkan::Device::open(device), threads);
}

}  // namespace redrive::kernels
