// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/host_raster.h"

#include <algorithm>

namespace redrive::kernels {

ImageLossOutput HostRaster::loss(const ImageLossInput& target, const PixelWeights& weights) {
  const RasterSize size = image_.size;
  const std::size_t plane = size.plane(), rows = size.height;
  d_rgb_.resize(3 * plane);
  error_.resize(plane);
  ImageLossInput input = target;
  input.size = size;
  input.rgb = image_.rgb.span().first(3 * plane);
  ImageLossOutput out = stages_.image_loss(input, d_rgb_, error_);

  const std::span<const float> log_range = options_.log_range;
  const std::span<const std::uint8_t> used = target.target.used;
  d_transmittance_.assign(plane, 0);
  d_range_.assign(log_range.empty() ? 0 : plane, 0);
  const double pixels = std::max(out.pixels, 1.0);
  const float each = weights.transmittance / static_cast<float>(pixels);
  std::vector<double> transmittance(rows), range(rows);
  const auto add_rows = [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      const std::size_t row = y * size.stride,
                        first = (target.target.y + y) * target.target.width + target.target.x;
      for (std::size_t x = 0; x < static_cast<std::size_t>(size.width); ++x) {
        if (!used.empty() && !used[first + x]) continue;
        transmittance[y] += static_cast<double>(image_.transmittance[row + x]);
        d_transmittance_[row + x] = each;
      }
      for (std::size_t x = 0; !log_range.empty() && x < static_cast<std::size_t>(size.width); ++x)
        if (log_range[row + x] != kNoRange) {
          d_range_[row + x] = weights.range;
          range[y] += static_cast<double>(image_.range_error[row + x]);
        }
    }
  };
  if (pool_)
    pool_->run_ranges(rows, kPatchSide, add_rows);
  else
    add_rows(0, rows);
  for (std::size_t y = 0; y < rows; ++y) {
    out.transmittance += transmittance[y] / pixels;
    out.range += static_cast<double>(weights.range) * range[y];
  }
  return out;
}

ImageLossOutput HostRaster::backward(const ImageLossInput& target, const PixelWeights& weights,
                                     const GaussianDerivatives& to,
                                     std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
  ImageLossOutput out = loss(target, weights);
  if (to.update && !is_finite(out))
    std::ranges::fill(d_poses, GaussianPoseGradient<NumberMath<double>>{});
  else
    backward({d_rgb_, d_transmittance_, error_, d_range_}, to, d_poses);
  return out;
}

}  // namespace redrive::kernels
