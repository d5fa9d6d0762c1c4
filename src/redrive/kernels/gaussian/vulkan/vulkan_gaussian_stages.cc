// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_gaussian_stages.h"

#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_loss.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_raster.h"

namespace redrive::kernels {
namespace {

class VulkanGaussianStages final : public GaussianStages {
 public:
  VulkanGaussianStages(vulkan::Device* device, ThreadPool* pool)
      : device_(*device), shared_(device, pool), loss_(&shared_) {}
  ~VulkanGaussianStages() override {
    try {
      device_.finish();  // before its memory goes
    } catch (const std::exception&) {
    }
  }

  Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                   const RasterOptions& options) override {
    auto raster = arena_.take<vulkan::VulkanRaster>(
        [this] { return std::make_unique<vulkan::VulkanRaster>(&shared_); });
    raster->forward(camera, gaussians, options);
    return {std::move(raster), &arena_};
  }

  ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                             std::span<float> error) override {
    check_image_loss(input, d_rgb.size(), error.size());
    device_.grow(&rgb_, input.rgb.size_bytes());
    device_.grow(&d_rgb_, d_rgb.size_bytes());
    device_.grow(&error_, error.size_bytes());
    device_.upload(rgb_, 0, input.rgb.data(), input.rgb.size_bytes());
    loss_.record({input.size, &rgb_, &d_rgb_, &error_}, input, {});
    device_.download(d_rgb_, 0, d_rgb.data(), d_rgb.size_bytes());
    device_.download(error_, 0, error.data(), error.size_bytes());
    device_.finish();
    return loss_.result();
  }

  void update_gaussians(const GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients, std::span<const float> errors) override {
    check_update_gaussians(update, n, gradients.size(), errors.size());
    shared_.hold(update, nullptr);
    device_.grow(&shared_.gradients, gradients.size_bytes());
    device_.grow(&shared_.errors, errors.size_bytes());
    device_.upload(shared_.gradients, 0, gradients.data(), gradients.size_bytes());
    device_.upload(shared_.errors, 0, errors.data(), errors.size_bytes());
    shared_.apply(update, n, nullptr, nullptr);
    device_.submit();
  }

  void fetch() override { shared_.fetch(); }
  /// Passes have none of the host's memory but their images, and are used again at once.
  void release() override {}

 private:
  vulkan::Device& device_;
  vulkan::GaussianDevice shared_;
  vulkan::VulkanLoss loss_;
  vulkan::DeviceBuffer rgb_, d_rgb_, error_;
  RasterArena arena_;
};

}  // namespace

std::unique_ptr<GaussianStages> make_vulkan_gaussian_stages(vulkan::Device* device,
                                                            ThreadPool* pool) {
  return std::make_unique<VulkanGaussianStages>(device, pool);
}

}  // namespace redrive::kernels
