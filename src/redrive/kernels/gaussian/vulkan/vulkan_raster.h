// SPDX-License-Identifier: Apache-2.0
// An image of Gaussians on a Vulkan device, and its backward pass.
#pragma once

#include <vector>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"
#include "redrive/kernels/gaussian/vulkan/vulkan_loss.h"

namespace redrive::kernels::vulkan {

class VulkanRaster final : public RasterPass {
 public:
  explicit VulkanRaster(GaussianDevice* shared) : shared_(*shared), loss_(shared) {}

  /// Records the forward pass.
  void forward(const GaussianCamera& camera, const Gaussians& gaussians,
               const RasterOptions& options);

  const RasterImage& image() override;
  RasterCounts counts() override;
  ImageLossOutput backward(const ImageLossInput& target, const PixelWeights& weights,
                           const GaussianDerivatives& to,
                           std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) override;
  void backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) override;

  /// GaussianStages::training_bytes.
  static std::uint64_t training_bytes(std::size_t n, std::size_t pixels);

 private:
  /// Sets the blocks of inputs_ that the parameters point into.
  void write_inputs();
  void allocate();
  void upload_ranges();
  void record_forward();
  void record_depth_order();
  void record_pairs();
  void record_parts();
  void fetch_parts();
  /// Makes what the backward pass writes.
  void allocate_backward();
  /// Records the backward pass of d_rgb_ and what is beside it, with the download of its results.
  void record_backward(const GaussianDerivatives& to, bool with_poses);
  /// Waits for them and hands them over.
  void take_results(const GaussianDerivatives& to,
                    std::span<GaussianPoseGradient<NumberMath<double>>> d_poses);
  /// Runs what is recorded, and the forward pass again as long as there were too many pairs.
  void complete();
  /// Whether the forward pass has to run again.
  bool overflowed();
  std::uint32_t model() const;
  bool has_ranges() const { return !options_.log_range.empty(); }
  bool has_centres() const { return !camera_.centres.u.empty(); }

  GaussianDevice& shared_;
  VulkanLoss loss_;
  GaussianCamera camera_;
  Gaussians gaussians_;
  RasterOptions options_;
  RasterSize size_;
  RasterImage image_;
  std::vector<std::byte> input_bytes_;
  std::size_t max_pairs_ = 0, parts_ = 0;
  const DeviceBuffer* numbers_ = nullptr;
  DeviceBuffer own_numbers_, inputs_, control_, records_, depth_key_, drawn_, pair_gaussian_,
      pair_blocks_, slots_, ranges_, rgb_, transmittance_, depth_, range_error_, log_range_,
      ranged_, last_, states_, segments_, d_rgb_, d_transmittance_, error_, d_range_, shown_,
      extents_;
  std::uint32_t control_words_[4] = {};
  std::vector<float> pose_sums_, gradients_, errors_;  ///< results of the backward pass
  bool complete_ = false, on_host_ = false;
};

}  // namespace redrive::kernels::vulkan
