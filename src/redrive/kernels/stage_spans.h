// SPDX-License-Identifier: Apache-2.0
// stage_input() returns a stage's argument with its spans in the memory where the stage runs. Stage
// is that of device/stage.h or HostStage; its in() copies a span or returns the span itself.
#pragma once

#include "redrive/kernels/grid_stages.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {

template <class Stage>
Rays stage_input(Stage& stage, const Rays& rays) {
  return {rays.n, stage.in(rays.origin), stage.in(rays.direction)};
}
template <class Stage>
Samples stage_input(Stage& stage, const Samples& samples) {
  return {samples.per_ray, stage.in(samples.t), stage.in(samples.dt)};
}
template <class Stage>
NerfField stage_input(Stage& stage, const NerfField& field) {
  return {field.config, field.unit_from_world, stage.in(field.parameters)};
}
template <class Stage>
Intervals stage_input(Stage& stage, const Intervals& intervals) {
  return {intervals.per_ray, stage.in(intervals.edges)};
}
template <class Stage>
HashGrid stage_input(Stage& stage, const HashGrid& grid) {
  return {grid.config, stage.in(grid.table)};
}
template <class Stage>
GridNetwork stage_input(Stage& stage, const GridNetwork& network) {
  return {network.config, network.density_scale, stage.in(network.weights)};
}
template <class Stage>
UnitPoints stage_input(Stage& stage, const UnitPoints& points) {
  return {points.n, stage.in(points.position), stage.in(points.footprint), points.stride};
}
template <class Stage>
Appearance stage_input(Stage& stage, const Appearance& appearance) {
  return {appearance.config, stage.in(appearance.parameters)};
}
template <class Stage>
ColourLossInput stage_input(Stage& stage, const ColourLossInput& colours) {
  return {stage_input(stage, colours.appearance),
          stage.in(colours.exposure),
          stage.in(colours.rgb),
          stage.in(colours.gains),
          stage.in(colours.target),
          stage.in(colours.weight),
          colours.huber_delta};
}

}  // namespace redrive::kernels
