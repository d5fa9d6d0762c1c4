// SPDX-License-Identifier: Apache-2.0
// The backend that rasterises Gaussians on a GPU by Vulkan compute.
#pragma once

#include <memory>
#include <string>

#include "redrive/kernels/backend.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels {

namespace vulkan {
class VulkanScore;
}

class VulkanBackend final : public Backend {
 public:
  VulkanBackend(std::unique_ptr<vulkan::Device> device, int threads);
  ~VulkanBackend() override;

  std::string name() const override { return "vulkan"; }
  std::optional<Isa> isa() const override { return std::nullopt; }
  std::string device() const override { return device_->info().name; }
  std::string driver() const override { return device_->info().driver; }
  std::uint64_t device_memory() const override { return device_->info().available; }
  std::map<std::string, double> take_stage_times() override { return queue_->take_times(); }

  bool marches_rays() const override { return false; }

  ImageScore score(const ImagePair& images) override;

  // UsageError: rays are marched on processors alone.
  void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                         std::span<const float> background, const CompositeOut& out) override;
  void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                          std::span<const float> background, const CompositeOutGradient& d_out,
                          std::span<float> d_raw) override;
  void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                        std::span<float> d_rgb, double* loss) override;
  void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
            std::span<float> first_moment, std::span<float> second_moment) override;
  NerfStages& nerf() override;
  GridStages& grid() override;
  GaussianStages& gaussians() override { return *gaussians_; }

 private:
  std::unique_ptr<vulkan::Device> device_;
  std::unique_ptr<vulkan::Queue> queue_;
  std::unique_ptr<GaussianStages> gaussians_;
  std::unique_ptr<vulkan::VulkanScore> score_;
};

}  // namespace redrive::kernels
