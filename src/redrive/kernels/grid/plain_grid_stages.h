// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid that are loops over the scalar functions in float. ref and cpu share
// them and override those that they compute in double or SIMD.
#pragma once

#include "redrive/base/buffer.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/kernels/ray_loop.h"

namespace redrive::kernels {

class PlainGridStages : public GridStages {
 public:
  explicit PlainGridStages(ThreadPool* pool) : loop_(pool) {}

  // ---- plain_grid_stages.cc: rays and intervals
  int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                   const RayCompaction& how, std::span<std::uint32_t> active) override;
  void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                   std::span<const float> from, std::span<float> to) override;
  void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                    std::span<const float> from, std::span<const float> otherwise,
                    std::span<float> to) override;
  void sample_uniform(const Rays& rays, const UniformSampling& how,
                      std::span<float> edges) override;
  void sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                  const PdfSampling& how, std::span<float> edges) override;
  void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                 std::span<float> dt) override;
  void contract(const Contraction& contraction, const Rays& rays,
                std::span<const float> pixel_angle, const Intervals& intervals, float least_width,
                std::span<float> position, std::span<float> footprint) override;
  void contract_backward(const Contraction& contraction, const Rays& rays,
                         const Intervals& intervals, std::span<const float> d_position,
                         std::span<float> d_origin, std::span<float> d_direction) override;
  void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
               std::span<float> weights) override;
  void weights_backward(int n_rays, const Intervals& intervals, std::span<const float> density,
                        std::span<const float> weights, std::span<const float> d_weights,
                        std::span<float> d_density) override;
  void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                    std::span<const float> opacity, std::span<float> depth) override;
  void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                     const Intervals& proposal, std::span<const float> proposal_weights,
                     double opacity_weight, std::span<float> d_proposal, double* loss) override;
  void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                  std::span<const float> range_m, float spread_m, float factor,
                  std::span<float> d_weights, double* loss) override;
  void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                     float factor, std::span<float> d_density, double* loss) override;

  // ---- plain_grid_colours.cc: colours of rays
  void harmonics(const Rays& rays, std::span<float> harmonics) override;
  void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
           std::span<float> colour) override;
  void sky_backward(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                    std::span<const float> colour, std::span<const float> opacity,
                    std::span<const float> d_rgb, std::span<float> d_table,
                    std::span<float> d_direction) override;
  void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                      std::span<float> gains, std::span<float> rgb) override;
  void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb, std::span<float> squares,
                  std::span<float> d_appearance, double* loss) override;

 protected:
  /// contract_backward with sums in T: float or double.
  template <class T>
  void contract_backward_in(const Contraction& contraction, const Rays& rays,
                            const Intervals& intervals, std::span<const float> d_position,
                            std::span<float> d_origin, std::span<float> d_direction);

 private:
  /// Returns the first n numbers of a buffer that is kept from call to call.
  static std::span<float> first(Buffer<float>* buffer, std::size_t n);
  UnitPoints sky_points(const Rays& rays, std::span<const float> pixel_angle);
  /// Adds the derivatives of the loss with respect to the cameras' gains. Returns their
  /// regulariser.
  double gains_backward(const ColourLossInput& colours, std::span<float> d_rgb,
                        std::span<float> d_appearance);

  const RayLoop loop_;
  Buffer<float> position_, footprint_, features_, d_position_;  // sky
};

}  // namespace redrive::kernels
