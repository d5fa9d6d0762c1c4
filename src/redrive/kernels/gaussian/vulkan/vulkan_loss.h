// SPDX-License-Identifier: Apache-2.0
// The loss of an image on a Vulkan device.
#pragma once

#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"

namespace redrive::kernels::vulkan {

/// Planes of an image on the device, where the derivatives of its loss go, and the control words
/// (common.glsl) of which one says that the loss is not finite.
struct LossPlanes {
  RasterSize size;
  const DeviceBuffer *rgb, *d_rgb, *error, *control;
  /// Null: not wanted; d_transmittance and d_range likewise.
  const DeviceBuffer *transmittance = nullptr, *d_transmittance = nullptr;
  const DeviceBuffer *range_error = nullptr, *log_range = nullptr, *d_range = nullptr;
};

/// Sums of a tile, and of the image, in shaders/loss.comp.
constexpr int kLossSums = 16;

class VulkanLoss {
 public:
  explicit VulkanLoss(GaussianDevice* shared) : shared_(*shared) {}

  /// Records the loss; result() is known when the device has finished.
  void record(const LossPlanes& planes, const ImageLossInput& target, const PixelWeights& weights);
  ImageLossOutput result();

 private:
  struct Parameters;
  /// Sends target and gains, and sets what the parameters say of them.
  void send(const ImageLossInput& input, Parameters* parameters);

  GaussianDevice& shared_;
  DeviceBuffer parameters_, gains_, target_, alpha_, used_, slopes_, tile_sums_, sums_, patches_;
  float image_sums_[kLossSums] = {};
  ImageLossOutput out_;
  double l1_weight_ = 0, ssim_weight_ = 0, range_weight_ = 0;
};

}  // namespace redrive::kernels::vulkan
