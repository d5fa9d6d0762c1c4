// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid on a device: CommonGridStages in kernels, and the stages that the
// host implements in another way. Between stages only the number of active rays and the losses are
// copied to the host.
#pragma once

#include <algorithm>

#include "redrive/kernels/common_grid_stages.h"
#include "redrive/kernels/device/fused_grid_network.h"
#include "redrive/kernels/device/grid_fp32_network.h"
#include "redrive/kernels/device/hash_grid_functors.h"
#include "redrive/kernels/device/ray_compaction_functors.h"
#include "redrive/kernels/device/stage.h"

namespace redrive::kernels {

/// Adds the derivatives of all rays with respect to the parameters of the gains
/// (CommonGridStages::huber_loss). Each knot sums its rays in kRayParts parts, so that the sums
/// have a fixed order.
template <class Device>
void add_gain_gradients(Stage<Device>& stage, const ColourLossInput& colours,
                        std::span<const float> d_rgb, std::span<float> d_appearance) {
  const std::size_t parameters = d_appearance.size();
  const auto partial = stage.template scratch<float>(kRayParts * parameters);
  stage.for_each(partial.size() / 3, ExposureKnotBackward{colours, d_rgb, partial});
  stage.for_each(parameters,
                 ReduceSlices{kRayParts, parameters, partial.data(), d_appearance.data()});
}

template <class Device>
class DeviceGridStages final : public CommonGridStages<DeviceExecutor<Device>> {
 public:
  explicit DeviceGridStages(Device& device)
      : CommonGridStages<DeviceExecutor<Device>>({&device}), device_(device) {}

  void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                   std::span<const float> from, std::span<float> to) override {
    const std::size_t each = check_gather_rays(rays.size(), to.size(), from.size());
    Stage stage(device_);
    stage.for_each(to.size(), GatherRayValues{offset_of(stage, rays, layout, each, from.size()),
                                              stage.in(from), stage.out(to)});
    stage.finish();
  }

  void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                    std::span<const float> from, std::span<const float> otherwise,
                    std::span<float> to) override {
    const std::size_t each =
        check_scatter_rays(rays.size(), from.size(), otherwise.size(), to.size());
    Stage stage(device_);
    const std::span<float> all = stage.out(to);
    stage.for_each(to.size(), CopyOrZero{stage.in(otherwise), all});
    stage.for_each(from.size(), ScatterRayValues{offset_of(stage, rays, layout, each, to.size()),
                                                 stage.in(from), all});
    stage.finish();
  }

  void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
           std::span<float> colour) override {
    check_sky(grid, rays, pixel_angle.size(), colour.size());
    Stage stage(device_);
    const UnitPoints points = sky_points(stage, rays, pixel_angle);
    const auto features = stage.template scratch<float>(points.n * grid.config.outputs());
    stage.for_each(points.n * grid.config.n_levels,
                   EncodePoints{GridLevels(stage_input(stage, grid)), points, features});
    stage.for_each(points.n, SkyColours{grid.config, points.n, features, stage.out(colour)});
    stage.finish();
  }

  void sky_backward(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                    std::span<const float> colour, std::span<const float> opacity,
                    std::span<const float> d_rgb, std::span<float> d_table,
                    std::span<float> d_direction) override {
    check_sky_backward(grid, rays, pixel_angle.size(), colour.size(), opacity.size(), d_rgb.size(),
                       d_table.size(), d_direction.size());
    Stage stage(device_);
    const UnitPoints points = sky_points(stage, rays, pixel_angle);
    const auto d_features = stage.template scratch<float>(points.n * grid.config.outputs());
    stage.for_each(points.n, SkyColoursBackward{grid.config, points.n, stage.in(colour),
                                                stage.in(opacity), stage.in(d_rgb), d_features});
    stage.for_each(points.n * grid.config.n_levels,
                   EncodeTableBackward{
                       GridLevels({grid.config, {}}), points, d_features, {stage.in_out(d_table)}});
    if (!d_direction.empty()) {
      const auto d_position = stage.template scratch<float>(d_direction.size());
      stage.for_each(points.n, EncodePositionBackward{GridLevels(stage_input(stage, grid)), points,
                                                      d_features, d_position});
      stage.for_each(d_position.size(),
                     SkyDirectionsBackward{d_position, stage.in_out(d_direction)});
    }
    stage.finish();
  }

  void encode(const HashGrid& grid, const UnitPoints& points, std::span<float> features) override {
    check_encode(grid, points, features.size());
    Stage stage(device_);
    stage.for_each(points.n * grid.config.n_levels,
                   EncodePoints{GridLevels(stage_input(stage, grid)), stage_input(stage, points),
                                stage.out(features)});
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
    const UnitPoints device_points = stage_input(stage, points);
    const std::span<const float> d = stage.in(d_features);
    stage.for_each(points.n * grid.config.n_levels,
                   EncodeTableBackward{levels, device_points, d, {stage.in_out(d_table)}});
    if (!d_position.empty())
      stage.for_each(points.n,
                     EncodePositionBackward{levels, device_points, d, stage.out(d_position)});
    stage.finish();
  }

  void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                       std::span<const float> features, std::span<const float> harmonics,
                       std::span<float> raw) override {
    check_network(network, n_rays, per_ray, features.size(), harmonics.size(), raw.size());
    const std::size_t n = interval_count(n_rays, per_ray),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    const GridNetwork device_network = stage_input(stage, network);
    const std::span<const float> x = stage.in(features), y = stage.in(harmonics);
    const std::span<float> out = stage.out(raw);
    if (device_.has_tensor_cores() && can_fuse(network.config, {x.data(), y.data()})) {
      FusedGridNetwork<Device>(stage, device_network, n, per_ray, x, y).forward(out);
    } else {
      GridFp32Network<Device> pass(stage, device_network, n, per_ray, most, x, y, {});
      for (std::size_t first = 0; first < n; first += most)
        pass.forward(first, std::min(most, n - first), {&out[first], 1, n});
    }
    stage.finish();
  }

  void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                        std::span<const float> features, std::span<const float> harmonics,
                        std::span<const float> d_raw, std::span<float> d_weights,
                        std::span<float> d_features) override {
    check_network_backward(network, n_rays, per_ray, features.size(), harmonics.size(),
                           d_raw.size(), d_weights.size(), d_features.size());
    const std::size_t n = interval_count(n_rays, per_ray),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    const GridNetwork device_network = stage_input(stage, network);
    const std::span<const float> x = stage.in(features), y = stage.in(harmonics),
                                 d = stage.in(d_raw);
    const std::span<float> gradients = stage.in_out(d_weights), out = stage.out(d_features);
    if (device_.has_tensor_cores() && can_fuse(network.config, {x.data(), y.data(), out.data()})) {
      FusedGridNetwork<Device>(stage, device_network, n, per_ray, x, y)
          .backward(std::min(n, Device::kMaxGridSamplesPerPass), d, gradients, out);
    } else {
      GridFp32Network<Device> pass(stage, device_network, n, per_ray, most, x, y, gradients);
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
    stage.for_each(points.n, ProposalDensity{GridLevels(stage_input(stage, grid)), density_scale,
                                             stage_input(stage, points), stage.out(density)});
    stage.finish();
  }

  void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                 std::span<const float> density, std::span<const float> d_density,
                                 std::span<float> d_table) override {
    check_proposal_density_backward(grid, points, density.size(), d_density.size(), d_table.size());
    Stage stage(device_);
    stage.for_each(points.n * grid.config.n_levels,
                   ProposalDensityBackward{GridLevels({grid.config, {}}),
                                           stage_input(stage, points),
                                           stage.in(density),
                                           stage.in(d_density),
                                           {stage.in_out(d_table)}});
    stage.finish();
  }

 private:
  /// Returns the offsets of the numbers of `rays` in an array of size `all`; `each`: size of the
  /// array of the listed rays.
  static GatherOffset offset_of(Stage<Device>& stage, std::span<const std::uint32_t> rays,
                                RayLayout layout, std::size_t each, std::size_t all) {
    return {stage.in(rays), layout == RayLayout::kRows, each, all / each};
  }
  static UnitPoints sky_points(Stage<Device>& stage, const Rays& rays,
                               std::span<const float> pixel_angle) {
    const std::size_t n = rays.n;
    const auto position = stage.template scratch<float>(3 * n),
               footprint = stage.template scratch<float>(n);
    stage.for_each(
        n, SkyPoints{directions_input(stage, rays), stage.in(pixel_angle), position, footprint});
    return {n, position, footprint};
  }

  Device& device_;
};

}  // namespace redrive::kernels
