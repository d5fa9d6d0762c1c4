// SPDX-License-Identifier: Apache-2.0
// The stages of grid_stages.h whose implementation is a loop over functors (functors/): one body
// for the host (host_stage.h) and for devices (device/stage.h). Backends override those for which
// they have kernels of their own.
#pragma once

#include "redrive/kernels/check_grid_sizes.h"
#include "redrive/kernels/check_ray_sizes.h"
#include "redrive/kernels/functors/colour_functors.h"
#include "redrive/kernels/functors/interval_functors.h"
#include "redrive/kernels/functors/loss_functors.h"
#include "redrive/kernels/loss_term.h"
#include "redrive/kernels/stage_spans.h"

namespace redrive::kernels {

/// Returns rays without origins, for stages that read the directions alone.
template <class Stage>
Rays directions_input(Stage& stage, const Rays& rays) {
  return {rays.n, {}, stage.in(rays.direction)};
}

/// Executor::stage() returns a HostStage or a Stage<Device>.
template <class Executor>
class CommonGridStages : public GridStages {
 public:
  explicit CommonGridStages(const Executor& executor) : executor_(executor) {}

  int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                   const RayCompaction& how, std::span<std::uint32_t> active) override {
    check_compact_rays(n_rays, per_ray, weights.size(), active.size());
    auto stage = executor_.stage();
    const std::span<std::uint32_t> list = stage.out(active);
    std::size_t count = stage.choose(n_rays, IsActiveRay{how, per_ray, stage.in(weights)}, list);
    if (count == 0) {
      stage.for_each(1, SetToRayZero{list});
      count = 1;
    }
    stage.finish();
    return static_cast<int>(count);
  }

  void sample_uniform(const Rays& rays, const UniformSampling& how,
                      std::span<float> edges) override {
    check_sample_uniform(rays, how.per_ray, edges.size());
    auto stage = executor_.stage();
    stage.for_each(rays.n, SampleUniform{stage_input(stage, rays), how, stage.out(edges)});
    stage.finish();
  }

  void sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                  const PdfSampling& how, std::span<float> edges) override {
    check_sample_pdf(n_rays, from, weights.size(), how.per_ray, edges.size());
    auto stage = executor_.stage();
    stage.for_each(n_rays,
                   SamplePdf{stage_input(stage, from), stage.in(weights), how, stage.out(edges)});
    stage.finish();
  }

  void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                 std::span<float> dt) override {
    check_midpoints(n_rays, intervals, t.size(), dt.size());
    auto stage = executor_.stage();
    stage.for_each(n_rays,
                   IntervalMidpoints{stage_input(stage, intervals), stage.out(t), stage.out(dt)});
    stage.finish();
  }

  void contract(const Contraction& contraction, const Rays& rays,
                std::span<const float> pixel_angle, const Intervals& intervals, float least_width,
                std::span<float> position, std::span<float> footprint) override {
    check_contract(rays, intervals, pixel_angle.size(), position.size(), footprint.size());
    auto stage = executor_.stage();
    stage.for_each(footprint.size(),
                   ContractSamples{contraction, stage_input(stage, rays), stage.in(pixel_angle),
                                   stage_input(stage, intervals), least_width, stage.out(position),
                                   stage.out(footprint)});
    stage.finish();
  }

  void contract_backward(const Contraction& contraction, const Rays& rays,
                         const Intervals& intervals, std::span<const float> d_position,
                         std::span<float> d_origin, std::span<float> d_direction) override {
    contract_backward_in<float>(contraction, rays, intervals, d_position, d_origin, d_direction);
  }

  void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
               std::span<float> weights) override {
    check_weights(n_rays, intervals, density.size(), weights.size());
    auto stage = executor_.stage();
    stage.for_each(
        n_rays, RayWeights{stage_input(stage, intervals), stage.in(density), stage.out(weights)});
    stage.finish();
  }

  void weights_backward(int n_rays, const Intervals& intervals, std::span<const float> density,
                        std::span<const float> weights, std::span<const float> d_weights,
                        std::span<float> d_density) override {
    check_weights_backward(n_rays, intervals, density.size(), weights.size(), d_weights.size(),
                           d_density.size());
    auto stage = executor_.stage();
    stage.for_each(
        n_rays, RayWeightsBackward{stage_input(stage, intervals), stage.in(density),
                                   stage.in(weights), stage.in(d_weights), stage.out(d_density)});
    stage.finish();
  }

  void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                    std::span<const float> opacity, std::span<float> depth) override {
    check_median_depth(n_rays, intervals, weights.size(), opacity.size(), depth.size());
    auto stage = executor_.stage();
    stage.for_each(n_rays, MedianDepths{stage_input(stage, intervals), stage.in(weights),
                                        stage.in(opacity), stage.out(depth)});
    stage.finish();
  }

  void harmonics(const Rays& rays, std::span<float> harmonics) override {
    check_harmonics(rays, harmonics.size());
    auto stage = executor_.stage();
    stage.for_each(rays.n, EncodeDirections{directions_input(stage, rays), stage.out(harmonics)});
    stage.finish();
  }

  void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                      std::span<float> gains, std::span<float> rgb) override {
    check_apply_exposure(appearance, exposure.size(), gains.size(), rgb.size());
    auto stage = executor_.stage();
    stage.for_each(exposure.size(),
                   ApplyExposure{stage_input(stage, appearance), stage.in(exposure),
                                 stage.out(gains), stage.in_out(rgb)});
    stage.finish();
  }

  void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb, std::span<float> squares,
                  std::span<float> d_appearance, double* loss) override {
    check_huber_loss(colours, d_rgb.size(), squares.size(), d_appearance.size());
    auto stage = executor_.stage();
    const ColourLossInput input = stage_input(stage, colours);
    const std::span<float> d = stage.in_out(d_rgb);
    const LossTerm of_colours{stage.reduce(squares.size(), HuberLoss{input, d, stage.out(squares)}),
                              3.0 * static_cast<double>(squares.size())};
    LossTerm of_gains;
    if (!input.exposure.empty()) {
      const std::span<float> d_parameters = stage.in_out(d_appearance);
      add_gain_gradients(stage, input, d, d_parameters);
      stage.for_each(d.size(), ScaleByGains{input.gains, d});
      of_gains.sum =
          stage.reduce(d_parameters.size(), GainRegulariserLoss{input.appearance, d_parameters});
    }
    stage.write_loss(of_colours, of_gains, loss);
    stage.finish();
  }

  void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                     const Intervals& proposal, std::span<const float> proposal_weights,
                     double opacity_weight, std::span<float> d_proposal, double* loss) override {
    check_proposal(n_rays, intervals, weights.size(), proposal, proposal_weights.size(),
                   d_proposal.size());
    auto stage = executor_.stage();
    const auto sum =
        stage.reduce(n_rays, ProposalLoss{n_rays, stage_input(stage, intervals), stage.in(weights),
                                          stage_input(stage, proposal), stage.in(proposal_weights),
                                          opacity_weight, stage.out(d_proposal)});
    stage.write_loss({sum, static_cast<double>(n_rays)}, loss);
    stage.finish();
  }

  void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                  std::span<const float> range_m, float spread_m, float factor,
                  std::span<float> d_weights, double* loss) override {
    check_range(n_rays, intervals, weights.size(), range_m.size(), spread_m, d_weights.size());
    auto stage = executor_.stage();
    const auto sum =
        stage.reduce(n_rays, RangeLoss{n_rays, stage_input(stage, intervals), stage.in(weights),
                                       stage.in(range_m), spread_m, factor, stage.out(d_weights)});
    stage.write_loss({sum, static_cast<double>(n_rays), factor}, loss);
    stage.finish();
  }

  void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                     float factor, std::span<float> d_density, double* loss) override {
    check_sparsity(n_rays, intervals, density.size(), d_density.size());
    auto stage = executor_.stage();
    const auto sum =
        stage.reduce(n_rays, SparsityLoss{n_rays, stage_input(stage, intervals), stage.in(density),
                                          factor, stage.in_out(d_density)});
    stage.write_loss({sum, static_cast<double>(n_rays), factor}, loss);
    stage.finish();
  }

 protected:
  /// contract_backward with sums in T.
  template <class T>
  void contract_backward_in(const Contraction& contraction, const Rays& rays,
                            const Intervals& intervals, std::span<const float> d_position,
                            std::span<float> d_origin, std::span<float> d_direction) {
    check_contract_backward(rays, intervals, d_position.size(), d_origin.size(),
                            d_direction.size());
    auto stage = executor_.stage();
    stage.for_each(rays.n, ContractBackward<T>{contraction, stage_input(stage, rays),
                                               stage_input(stage, intervals), stage.in(d_position),
                                               stage.out(d_origin), stage.out(d_direction)});
    stage.finish();
  }

  Executor executor_;
};

}  // namespace redrive::kernels
