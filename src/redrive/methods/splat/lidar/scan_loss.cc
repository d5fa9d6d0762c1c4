// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/scan_loss.h"

namespace redrive {

double scan_loss(const kernels::RasterImage& image, const ScanTarget& target,
                 const ScanWeights& weights, ScanGradient* gradient) {
  const std::size_t plane = image.size.plane();
  gradient->d_rgb.assign(3 * plane, 0);
  gradient->d_transmittance.assign(plane, 0);
  gradient->d_range.assign(plane, 0);
  double sum = 0;
  for (std::size_t i = 0; i < plane; ++i) {
    const float weight = target.weight[i];
    if (weight == 0) continue;
    const bool returned = target.log_range[i] != kernels::kNoRange;
    const float off = image.rgb[kReturnSlot * plane + i] - (returned ? 1.0f : 0.0f);
    sum += double(weight * weights.returns * off * off);
    gradient->d_rgb[kReturnSlot * plane + i] = 2 * weight * weights.returns * off;
    if (!returned) continue;
    sum += double(weight * weights.range * image.range_error[i]);
    gradient->d_range[i] = weight * weights.range;
    const float wrong = image.rgb[kIntensitySlot * plane + i] -
                        (1 - image.transmittance[i]) * target.intensity[i],
                by_wrong = 2 * weight * weights.intensity * wrong;
    sum += double(weight * weights.intensity * wrong * wrong);
    gradient->d_rgb[kIntensitySlot * plane + i] = by_wrong;
    gradient->d_transmittance[i] = by_wrong * target.intensity[i];
  }
  return sum;
}

}  // namespace redrive
