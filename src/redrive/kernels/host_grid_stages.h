// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid that the backends on the host share: CommonGridStages in loops, and
// the stages that devices implement in another way.
#pragma once

#include "redrive/base/buffer.h"
#include "redrive/kernels/common_grid_stages.h"
#include "redrive/kernels/host_stage.h"

namespace redrive::kernels {

/// Adds the derivatives of all rays with respect to the parameters of the gains
/// (CommonGridStages::huber_loss).
void add_gain_gradients(HostStage& stage, const ColourLossInput& colours,
                        std::span<const float> d_rgb, std::span<float> d_appearance);

extern template class CommonGridStages<HostExecutor>;

class HostGridStages : public CommonGridStages<HostExecutor> {
 public:
  using CommonGridStages::CommonGridStages;

  void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                   std::span<const float> from, std::span<float> to) override;
  void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                    std::span<const float> from, std::span<const float> otherwise,
                    std::span<float> to) override;
  void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
           std::span<float> colour) override;
  void sky_backward(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                    std::span<const float> colour, std::span<const float> opacity,
                    std::span<const float> d_rgb, std::span<float> d_table,
                    std::span<float> d_direction) override;

 private:
  /// Returns the first n numbers of a buffer that is kept from call to call.
  static std::span<float> first(Buffer<float>* buffer, std::size_t n);
  UnitPoints sky_points(const Rays& rays, std::span<const float> pixel_angle);

  Buffer<float> position_, footprint_, features_, d_position_;  // sky
};

}  // namespace redrive::kernels
