// SPDX-License-Identifier: Apache-2.0
// What stages are given, with its spans on the device (stage.h, in).
#pragma once

#include "redrive/kernels/device/stage.h"
#include "redrive/kernels/grid_stages.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {

template <class Device>
Rays there(Stage<Device>& stage, const Rays& rays) {
  return {rays.n, stage.in(rays.origin), stage.in(rays.direction)};
}
template <class Device>
Samples there(Stage<Device>& stage, const Samples& samples) {
  return {samples.per_ray, stage.in(samples.t), stage.in(samples.dt)};
}
template <class Device>
NerfField there(Stage<Device>& stage, const NerfField& field) {
  return {field.config, field.unit_from_world, stage.in(field.parameters)};
}
template <class Device>
Intervals there(Stage<Device>& stage, const Intervals& intervals) {
  return {intervals.per_ray, stage.in(intervals.edges)};
}
template <class Device>
HashGrid there(Stage<Device>& stage, const HashGrid& grid) {
  return {grid.config, stage.in(grid.table)};
}
template <class Device>
GridNetwork there(Stage<Device>& stage, const GridNetwork& network) {
  return {network.config, network.density_scale, stage.in(network.weights)};
}
template <class Device>
UnitPoints there(Stage<Device>& stage, const UnitPoints& points) {
  return {points.n, stage.in(points.position), stage.in(points.footprint), points.stride};
}
template <class Device>
Appearance there(Stage<Device>& stage, const Appearance& appearance) {
  return {appearance.config, stage.in(appearance.parameters)};
}
template <class Device>
ColourLossInput there(Stage<Device>& stage, const ColourLossInput& colours) {
  return {there(stage, colours.appearance),
          stage.in(colours.exposure),
          stage.in(colours.rgb),
          stage.in(colours.gains),
          stage.in(colours.target),
          stage.in(colours.weight),
          colours.huber_delta};
}

}  // namespace redrive::kernels
