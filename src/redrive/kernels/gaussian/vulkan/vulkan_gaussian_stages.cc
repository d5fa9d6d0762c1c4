// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_gaussian_stages.h"

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/plain_points.h"
#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_loss.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_raster.h"

namespace redrive::kernels {
namespace {

class VulkanGaussianStages final : public GaussianStages {
 public:
  VulkanGaussianStages(vulkan::Queue* queue, ThreadPool* pool)
      : queue_(*queue), pool_(pool), shared_(queue, pool), loss_(&shared_) {}
  ~VulkanGaussianStages() override { queue_.wait_idle(); }  // before its memory goes

  Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                   const RasterOptions& options) override {
    auto raster = arena_.take<vulkan::VulkanRaster>(
        [this] { return std::make_unique<vulkan::VulkanRaster>(&shared_); });
    try {
      raster->forward(camera, gaussians, options);
    } catch (const Interrupted&) {
      queue_.finish();  // what is recorded uses the pass's memory
      throw;
    } catch (const DeviceError&) {
      queue_.wait_idle();  // likewise what still runs
      throw;
    }
    return {std::move(raster), &arena_};
  }

  ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                             std::span<float> error) override {
    check_image_loss(input, d_rgb.size(), error.size());
    queue_.grow(&rgb_, input.rgb.size_bytes());
    queue_.grow(&d_rgb_, d_rgb.size_bytes());
    queue_.grow(&error_, error.size_bytes());
    queue_.grow(&control_, vulkan::kControlWords * sizeof(std::uint32_t));
    queue_.upload(rgb_, 0, input.rgb.data(), input.rgb.size_bytes());
    loss_.record({input.size, &rgb_, &d_rgb_, &error_, &control_}, input, {});
    queue_.download(d_rgb_, 0, d_rgb.data(), d_rgb.size_bytes());
    queue_.download(error_, 0, error.data(), error.size_bytes());
    queue_.finish();
    return loss_.result();
  }

  void update_gaussians(const GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients, std::span<const float> errors) override {
    check_update_gaussians(update, n, gradients.size(), errors.size());
    shared_.hold(update);
    queue_.grow(&shared_.gradients, gradients.size_bytes());
    queue_.grow(&shared_.errors, errors.size_bytes());
    queue_.upload(shared_.gradients, 0, gradients.data(), gradients.size_bytes());
    queue_.upload(shared_.errors, 0, errors.data(), errors.size_bytes());
    shared_.apply(update, n, nullptr, nullptr);
    queue_.submit();
  }

  /// On the host: points come from there and pixels go there.
  void project_points(const GaussianCamera& camera, std::span<const float> points,
                      std::span<float> pixels) override {
    project_plain_points(camera, points, pool_, pixels);
  }
  void fetch() override { shared_.fetch(); }
  std::uint64_t training_bytes(std::size_t n, std::size_t pixels) const override {
    return vulkan::VulkanRaster::training_bytes(n, pixels);
  }
  void keep_targets(std::uint64_t bytes) override { shared_.targets.allow(bytes); }
  /// Passes have none of the host's memory but their images, and are used again at once.
  void release() override {}

 private:
  vulkan::Queue& queue_;
  ThreadPool* const pool_;
  vulkan::GaussianDevice shared_;
  vulkan::VulkanLoss loss_;
  vulkan::DeviceBuffer rgb_, d_rgb_, error_, control_;
  RasterArena arena_;
};

}  // namespace

std::unique_ptr<GaussianStages> make_vulkan_gaussian_stages(vulkan::Queue* queue,
                                                            ThreadPool* pool) {
  return std::make_unique<VulkanGaussianStages>(queue, pool);
}

}  // namespace redrive::kernels
