// SPDX-License-Identifier: Apache-2.0
// The arguments of stages with their spans where the stage runs: Stage is device/stage.h's or
// HostStage, whose in() makes the copy or returns the span itself.
#pragma once

#include "redrive/kernels/grid_stages.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {

template <class Stage>
Rays there(Stage& stage, const Rays& rays) {
  return {rays.n, stage.in(rays.origin), stage.in(rays.direction)};
}
template <class Stage>
Samples there(Stage& stage, const Samples& samples) {
  return {samples.per_ray, stage.in(samples.t), stage.in(samples.dt)};
}
template <class Stage>
NerfField there(Stage& stage, const NerfField& field) {
  return {field.config, field.unit_from_world, stage.in(field.parameters)};
}
template <class Stage>
Intervals there(Stage& stage, const Intervals& intervals) {
  return {intervals.per_ray, stage.in(intervals.edges)};
}
template <class Stage>
HashGrid there(Stage& stage, const HashGrid& grid) {
  return {grid.config, stage.in(grid.table)};
}
template <class Stage>
GridNetwork there(Stage& stage, const GridNetwork& network) {
  return {network.config, network.density_scale, stage.in(network.weights)};
}
template <class Stage>
UnitPoints there(Stage& stage, const UnitPoints& points) {
  return {points.n, stage.in(points.position), stage.in(points.footprint), points.stride};
}
template <class Stage>
Appearance there(Stage& stage, const Appearance& appearance) {
  return {appearance.config, stage.in(appearance.parameters)};
}
template <class Stage>
ColourLossInput there(Stage& stage, const ColourLossInput& colours) {
  return {there(stage, colours.appearance),
          stage.in(colours.exposure),
          stage.in(colours.rgb),
          stage.in(colours.gains),
          stage.in(colours.target),
          stage.in(colours.weight),
          colours.huber_delta};
}

}  // namespace redrive::kernels
