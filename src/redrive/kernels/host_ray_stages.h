// SPDX-License-Identifier: Apache-2.0
// What the backends on the host have in common of the stages of --method grid: those that treat
// whole rays take too small a part of a step for a second version.
#pragma once

#include "redrive/base/buffer.h"
#include "redrive/kernels/grid_stages.h"

namespace redrive::kernels {

class HostRayStages : public GridStages {
 public:
  int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                   const RayCompaction& how, std::span<std::uint32_t> live) override;
  void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                   std::span<const float> from, std::span<float> to) override;
  void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                    std::span<const float> from, std::span<const float> elsewhere,
                    std::span<float> to) override;
  void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                 std::span<float> dt) override;
  void harmonics(const Rays& rays, std::span<float> harmonics) override;
  void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
           std::span<float> colour) override;
  void sky_backward(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                    std::span<const float> colour, std::span<const float> opacity,
                    std::span<const float> d_rgb, std::span<float> d_table,
                    std::span<float> d_direction) override;
  void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                      std::span<float> gains, std::span<float> rgb) override;
  void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                    std::span<const float> opacity, std::span<float> depth) override;
  void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb, std::span<float> squares,
                  std::span<float> d_appearance, double* loss) override;

 private:
  /// The first n numbers of a buffer that is kept from call to call.
  static std::span<float> first(Buffer<float>* buffer, std::size_t n);
  UnitPoints sky_points(const Rays& rays, std::span<const float> pixel_angle);

  Buffer<float> position_, footprint_, features_, d_position_;  // of the sky
};

}  // namespace redrive::kernels
