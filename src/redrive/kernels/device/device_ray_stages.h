// SPDX-License-Identifier: Apache-2.0
// The stages of --method grid that treat whole rays, on a device: so that nothing between the
// others has to come to the host but how many rays are live, and losses.
#pragma once

#include "redrive/kernels/device/fp32_layer_functors.h"
#include "redrive/kernels/device/grid_functors.h"
#include "redrive/kernels/device/ray_work_functors.h"
#include "redrive/kernels/device/spans_on_device.h"

namespace redrive::kernels {

template <class Device>
class DeviceRayStages : public GridStages {
 public:
  explicit DeviceRayStages(Device& device) : device_(device) {}

  int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                   const RayCompaction& how, std::span<std::uint32_t> live) override {
    check_compact_rays(n_rays, per_ray, weights.size(), live.size());
    Stage stage(device_);
    const std::span<std::uint32_t> list = stage.out(live);
    std::size_t count = stage.choose(n_rays, IsActiveRay{how, per_ray, stage.in(weights)}, list);
    if (count == 0) {
      stage.for_each(1, SetToRayZero{list});
      count = 1;
    }
    stage.finish();
    return static_cast<int>(count);
  }

  void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                   std::span<const float> from, std::span<float> to) override {
    const std::size_t each = check_gather_rays(rays.size(), to.size(), from.size());
    Stage stage(device_);
    stage.for_each(to.size(), GatherRayValues{place(stage, rays, layout, each, from.size()),
                                              stage.in(from), stage.out(to)});
    stage.finish();
  }

  void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                    std::span<const float> from, std::span<const float> elsewhere,
                    std::span<float> to) override {
    const std::size_t each =
        check_scatter_rays(rays.size(), from.size(), elsewhere.size(), to.size());
    Stage stage(device_);
    const std::span<float> all = stage.out(to);
    stage.for_each(to.size(), CopyOrZero{stage.in(elsewhere), all});
    stage.for_each(from.size(), ScatterRayValues{place(stage, rays, layout, each, to.size()),
                                                 stage.in(from), all});
    stage.finish();
  }

  void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                 std::span<float> dt) override {
    check_midpoints(n_rays, intervals, t.size(), dt.size());
    Stage stage(device_);
    stage.for_each(n_rays, IntervalMidpoints{there(stage, intervals), stage.out(t), stage.out(dt)});
    stage.finish();
  }

  void harmonics(const Rays& rays, std::span<float> harmonics) override {
    check_harmonics(rays, harmonics.size());
    Stage stage(device_);
    stage.for_each(rays.n, EncodeDirections{directions(stage, rays), stage.out(harmonics)});
    stage.finish();
  }

  void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
           std::span<float> colour) override {
    check_sky(grid, rays, pixel_angle.size(), colour.size());
    Stage stage(device_);
    const UnitPoints points = sky_points(stage, rays, pixel_angle);
    const auto features = stage.template scratch<float>(points.n * grid.config.outputs());
    stage.for_each(points.n * grid.config.levels,
                   EncodePoints{GridLevels(there(stage, grid)), points, features});
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
    stage.for_each(points.n * grid.config.levels,
                   EncodeTableBackward{
                       GridLevels({grid.config, {}}), points, d_features, {stage.in_out(d_table)}});
    if (!d_direction.empty()) {
      const auto d_position = stage.template scratch<float>(d_direction.size());
      stage.for_each(points.n, EncodePositionBackward{GridLevels(there(stage, grid)), points,
                                                      d_features, d_position});
      stage.for_each(d_position.size(),
                     SkyDirectionsBackward{d_position, stage.in_out(d_direction)});
    }
    stage.finish();
  }

  void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                      std::span<float> gains, std::span<float> rgb) override {
    check_apply_exposure(appearance, exposure.size(), gains.size(), rgb.size());
    Stage stage(device_);
    stage.for_each(exposure.size(), ApplyExposure{there(stage, appearance), stage.in(exposure),
                                                  stage.out(gains), stage.in_out(rgb)});
    stage.finish();
  }

  void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                    std::span<const float> opacity, std::span<float> depth) override {
    check_median_depth(n_rays, intervals, weights.size(), opacity.size(), depth.size());
    Stage stage(device_);
    stage.for_each(n_rays, MedianDepths{there(stage, intervals), stage.in(weights),
                                        stage.in(opacity), stage.out(depth)});
    stage.finish();
  }

  void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb, std::span<float> squares,
                  std::span<float> d_appearance, double* loss) override {
    check_huber_loss(colours, d_rgb.size(), squares.size(), d_appearance.size());
    Stage stage(device_);
    const ColourLossInput here = there(stage, colours);
    const std::span<float> d = stage.in_out(d_rgb);
    const LossTerm of_colours{
        stage.sum_on_device(squares.size(), HuberLoss{here, d, stage.out(squares)}),
        3.0 * static_cast<double>(squares.size())};
    LossTerm of_gains;
    if (!here.exposure.empty()) {
      const std::span<float> d_parameters = stage.in_out(d_appearance);
      const std::size_t parameters = d_parameters.size();
      const auto partial = stage.template scratch<float>(kRayParts * parameters);
      stage.for_each(partial.size() / 3, ExposureKnotBackward{here, d, partial});
      stage.for_each(parameters,
                     ReduceSlices{kRayParts, parameters, partial.data(), d_parameters.data()});
      stage.for_each(d.size(), ScaleByGains{here.gains, d});
      of_gains.sum =
          stage.sum_on_device(parameters, GainRegularizer{here.appearance, d_parameters});
    }
    stage.put_loss(of_colours, of_gains, loss);
    stage.finish();
  }

 protected:
  Device& device_;

 private:
  /// Where `rays` have their numbers, `each`, among `all`.
  static GatherOffset place(Stage<Device>& stage, std::span<const std::uint32_t> rays,
                            RayLayout layout, std::size_t each, std::size_t all) {
    return {stage.in(rays), layout == RayLayout::kRows, each, all / each};
  }
  /// Of rays of which nobody asks for the origins.
  static Rays directions(Stage<Device>& stage, const Rays& rays) {
    return {rays.n, {}, stage.in(rays.direction)};
  }

  static UnitPoints sky_points(Stage<Device>& stage, const Rays& rays,
                               std::span<const float> pixel_angle) {
    const std::size_t n = rays.n;
    const auto position = stage.template scratch<float>(3 * n),
               footprint = stage.template scratch<float>(n);
    stage.for_each(n,
                   SkyPoints{directions(stage, rays), stage.in(pixel_angle), position, footprint});
    return {n, position, footprint};
  }
};

}  // namespace redrive::kernels
