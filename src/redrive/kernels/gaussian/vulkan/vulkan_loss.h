// SPDX-License-Identifier: Apache-2.0
// The loss of an image on a Vulkan device.
#pragma once

#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"

namespace redrive::kernels::vulkan {

/// Planes of an image on the device, and where the derivatives of its loss go.
struct LossPlanes {
  RasterSize size;
  const DeviceBuffer *rgb, *d_rgb, *error;
  /// Null: not wanted; d_transmittance and d_range likewise.
  const DeviceBuffer *transmittance = nullptr, *d_transmittance = nullptr;
  const DeviceBuffer *range_error = nullptr, *log_range = nullptr, *d_range = nullptr;
};

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
  DeviceBuffer parameters_, gains_, target_, alpha_, used_, slopes_, sums_, patches_;
  std::vector<float> tile_sums_;
  ImageLossOutput out_;
  double l1_weight_ = 0, ssim_weight_ = 0, pixels_ = 0, range_weight_ = 0;
};

}  // namespace redrive::kernels::vulkan
