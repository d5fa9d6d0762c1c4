// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid on a device.
#pragma once

#include "redrive/kernels/check_grid_sizes.h"
#include "redrive/kernels/device/device_ray_stages.h"
#include "redrive/kernels/device/fused_grid_network.h"
#include "redrive/kernels/device/grid_fp32_network.h"
#include "redrive/kernels/device/grid_functors.h"
#include "redrive/kernels/device/spans_on_device.h"

namespace redrive::kernels {

template <class Device>
class DeviceGridStages final : public DeviceRayStages<Device> {
 public:
  explicit DeviceGridStages(Device& device) : DeviceRayStages<Device>(device) {}

  void sample_uniform(const Rays& rays, const UniformSampling& how,
                      std::span<float> edges) override {
    check_sample_uniform(rays, how.per_ray, edges.size());
    Stage stage(device_);
    stage.for_each(rays.n, SampleUniform{there(stage, rays), how, stage.out(edges)});
    stage.finish();
  }

  void sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                  const PdfSampling& how, std::span<float> edges) override {
    check_sample_pdf(n_rays, from, weights.size(), how.per_ray, edges.size());
    Stage stage(device_);
    stage.for_each(n_rays, SamplePdf{there(stage, from), stage.in(weights), how, stage.out(edges)});
    stage.finish();
  }

  void contract(const Contraction& contraction, const Rays& rays,
                std::span<const float> pixel_angle, const Intervals& intervals, float least_width,
                std::span<float> position, std::span<float> footprint) override {
    check_contract(rays, intervals, pixel_angle.size(), position.size(), footprint.size());
    Stage stage(device_);
    stage.for_each(footprint.size(),
                   ContractSamples{contraction, there(stage, rays), stage.in(pixel_angle),
                                   there(stage, intervals), least_width, stage.out(position),
                                   stage.out(footprint)});
    stage.finish();
  }

  void contract_backward(const Contraction& contraction, const Rays& rays,
                         const Intervals& intervals, std::span<const float> d_position,
                         std::span<float> d_origin, std::span<float> d_direction) override {
    check_contract_backward(rays, intervals, d_position.size(), d_origin.size(),
                            d_direction.size());
    Stage stage(device_);
    stage.for_each(rays.n, ContractBackward{contraction, there(stage, rays),
                                            there(stage, intervals), stage.in(d_position),
                                            stage.out(d_origin), stage.out(d_direction)});
    stage.finish();
  }

  void encode(const HashGrid& grid, const UnitPoints& points, std::span<float> features) override {
    check_encode(grid, points, features.size());
    Stage stage(device_);
    stage.for_each(
        points.n * grid.config.levels,
        EncodePoints{GridLevels(there(stage, grid)), there(stage, points), stage.out(features)});
    stage.finish();
  }

  void encode_backward(const HashGrid& grid, const UnitPoints& points,
                       std::span<const float> d_features, std::span<float> d_table,
                       std::span<float> d_position) override {
    check_encode_backward(grid, points, d_features.size(), d_table.size(), d_position.size());
    Stage stage(device_);
    const HashGrid values{grid.config,
                          d_position.empty() ? std::span<const float>() : stage.in(grid.table)};
    const GridLevels levels(values);
    const UnitPoints points_there = there(stage, points);
    const std::span<const float> d = stage.in(d_features);
    stage.for_each(points.n * grid.config.levels,
                   EncodeTableBackward{levels, points_there, d, {stage.in_out(d_table)}});
    if (!d_position.empty())
      stage.for_each(points.n,
                     EncodePositionBackward{levels, points_there, d, stage.out(d_position)});
    stage.finish();
  }

  void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                       std::span<const float> features, std::span<const float> harmonics,
                       std::span<float> raw) override {
    check_network(network, n_rays, per_ray, features.size(), harmonics.size(), raw.size());
    const std::size_t n = interval_count(n_rays, per_ray),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    const GridNetwork network_there = there(stage, network);
    const std::span<const float> x = stage.in(features), y = stage.in(harmonics);
    const std::span<float> out = stage.out(raw);
    if (device_.has_tensor_cores() && can_fuse(network.config, {x.data(), y.data()})) {
      FusedGridNetwork<Device>(stage, network_there, n, per_ray, x, y).forward(out);
    } else {
      GridFp32Network<Device> pass(stage, network_there, n, per_ray, most, x, y, {});
      for (std::size_t first = 0; first < n; first += most)
        pass.forward(first, std::min(most, n - first), {&out[first], 1, n});
    }
    stage.finish();
  }

  void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                        std::span<const float> features, std::span<const float> harmonics,
                        std::span<const float> d_raw, std::span<float> d_weights,
                        std::span<float> d_features) override {
    check_network(network, n_rays, per_ray, features.size(), harmonics.size(), d_raw.size());
    REDRIVE_CHECK_OP(d_weights.size(), ==, network.weights.size());
    REDRIVE_CHECK_OP(d_features.size(), ==, features.size());
    const std::size_t n = interval_count(n_rays, per_ray),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    const GridNetwork network_there = there(stage, network);
    const std::span<const float> x = stage.in(features), y = stage.in(harmonics),
                                 d = stage.in(d_raw);
    const std::span<float> gradients = stage.in_out(d_weights), out = stage.out(d_features);
    if (device_.has_tensor_cores() && can_fuse(network.config, {x.data(), y.data(), out.data()})) {
      FusedGridNetwork<Device>(stage, network_there, n, per_ray, x, y)
          .backward(std::min(n, Device::kMaxGridSamplesPerPass), d, gradients, out);
    } else {
      GridFp32Network<Device> pass(stage, network_there, n, per_ray, most, x, y, gradients);
      for (std::size_t first = 0; first < n; first += most) {
        const std::size_t count = std::min(most, n - first);
        pass.forward(first, count, {});
        pass.backward(first, count, {&d[first], 1, n}, out);
      }
    }
    stage.finish();
  }

  void proposal_density(const HashGrid& grid, float density_scale, const UnitPoints& points,
                        std::span<float> density) override {
    check_proposal_density(grid, points, density.size());
    Stage stage(device_);
    stage.for_each(points.n, ProposalDensity{GridLevels(there(stage, grid)), density_scale,
                                             there(stage, points), stage.out(density)});
    stage.finish();
  }

  void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                 std::span<const float> density, std::span<const float> d_density,
                                 std::span<float> d_table) override {
    check_proposal_density_backward(grid, points, density.size(), d_density.size(), d_table.size());
    Stage stage(device_);
    stage.for_each(points.n * grid.config.levels,
                   ProposalDensityBackward{GridLevels({grid.config, {}}),
                                           there(stage, points),
                                           stage.in(density),
                                           stage.in(d_density),
                                           {stage.in_out(d_table)}});
    stage.finish();
  }

  void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
               std::span<float> weights) override {
    check_weights(n_rays, intervals, density.size(), weights.size());
    Stage stage(device_);
    stage.for_each(n_rays,
                   RayWeights{there(stage, intervals), stage.in(density), stage.out(weights)});
    stage.finish();
  }

  void weights_backward(int n_rays, const Intervals& intervals, std::span<const float> density,
                        std::span<const float> weights, std::span<const float> d_weights,
                        std::span<float> d_density) override {
    check_weights_backward(n_rays, intervals, density.size(), weights.size(), d_weights.size(),
                           d_density.size());
    Stage stage(device_);
    stage.for_each(n_rays,
                   RayWeightsBackward{there(stage, intervals), stage.in(density), stage.in(weights),
                                      stage.in(d_weights), stage.out(d_density)});
    stage.finish();
  }

  void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                     const Intervals& proposal, std::span<const float> proposal_weights,
                     std::span<float> d_proposal, double* loss) override {
    check_proposal(n_rays, intervals, weights.size(), proposal, proposal_weights.size(),
                   d_proposal.size());
    Stage stage(device_);
    const auto sum =
        stage.sum_on_device(n_rays, ProposalLoss{n_rays, there(stage, intervals), stage.in(weights),
                                                 there(stage, proposal), stage.in(proposal_weights),
                                                 stage.out(d_proposal)});
    stage.put_loss({sum, static_cast<double>(n_rays)}, loss);
    stage.finish();
  }

  void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                  std::span<const float> range_m, float spread_m, float factor,
                  std::span<float> d_weights, double* loss) override {
    check_range(n_rays, intervals, weights.size(), range_m.size(), spread_m, d_weights.size());
    Stage stage(device_);
    const auto sum = stage.sum_on_device(
        n_rays, RangeLoss{n_rays, there(stage, intervals), stage.in(weights), stage.in(range_m),
                          spread_m, factor, stage.out(d_weights)});
    stage.put_loss({sum, static_cast<double>(n_rays), factor}, loss);
    stage.finish();
  }

  void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                     float factor, std::span<float> d_density, double* loss) override {
    check_sparsity(n_rays, intervals, density.size(), d_density.size());
    Stage stage(device_);
    const auto sum =
        stage.sum_on_device(n_rays, SparsityLoss{n_rays, there(stage, intervals), stage.in(density),
                                                 factor, stage.in_out(d_density)});
    stage.put_loss({sum, static_cast<double>(n_rays), factor}, loss);
    stage.finish();
  }

 private:
  using DeviceRayStages<Device>::device_;
};

}  // namespace redrive::kernels
