// SPDX-License-Identifier: Apache-2.0
// A raster pass whose image lies in the processor's memory.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

class HostRaster : public RasterPass {
 public:
  /// pool: null: one thread. Both must outlive the pass.
  HostRaster(GaussianStages* stages, ThreadPool* pool) : stages_(*stages), pool_(pool) {}

  const RasterImage& image() override { return image_; }
  RasterCounts counts() override { return counts_; }
  using RasterPass::backward;
  ImageLossOutput backward(const ImageLossInput& target, const PixelWeights& weights,
                           const GaussianDerivatives& to,
                           std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) override;

 protected:
  RasterOptions options_;
  RasterImage image_;
  RasterCounts counts_;

 private:
  ImageLossOutput loss(const ImageLossInput& target, const PixelWeights& weights);

  GaussianStages& stages_;
  ThreadPool* const pool_;
  std::vector<float> d_rgb_, d_transmittance_, error_, d_range_;  ///< set by loss()
};

}  // namespace redrive::kernels
