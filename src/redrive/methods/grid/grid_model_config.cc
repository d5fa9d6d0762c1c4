// SPDX-License-Identifier: Apache-2.0
// Hyperparameters of the grid model: names and ranges, values that follow from the scene, schedule.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <Eigen/Geometry>

#include "redrive/methods/grid/grid_model.h"

namespace redrive {

GridModel::GridModel() {
  batch_rays = 2048;
  error_rays = 0.5;
  lidar_rays = 512;
  initial_rate = 2e-2;
  rate_gamma = 0.1;
}

Method grid_method() {
  return {
      .name = "grid",
      .help = "a hash-grid field for unbounded scenes with proposal sampling",
      .make = [] { return std::unique_ptr<Trainee>(std::make_unique<GridModel>()); },
      .presets = {{"fast", "", {{"max-seconds", "60"}}}, {"best", "", {{"max-seconds", "1200"}}}},
      .refines_poses = true,
      .random_background = true,
      .contracts_space = true,
      .benchmarks = grid_benchmarks};
}

void GridModel::visit_hyperparameters(HyperparameterVisitor& visit) {
  const auto visit_grid = [&](const std::string& name, HashGridConfig& grid, int least_levels,
                              double features_low, double features_high) {
    visit({name + ".n_levels", "levels of the hash grid", double(least_levels), 16}, grid.n_levels);
    visit({name + ".features_per_level", "numbers of a row", features_low, features_high},
          grid.features_per_level);
    visit({name + ".base_resolution", "cells a side of the coarsest level", 1, 1 << 20},
          grid.base_resolution);
    visit({name + ".max_resolution", "cells a side of the finest level", 1, 1 << 20},
          grid.max_resolution);
    visit({name + ".log2_hashmap_size", "log2 of the rows of a level, at most", 4, 24},
          grid.log2_hashmap_size);
    visit({name + ".min_level_weight",
           "levels of a smaller weight, by the sample's footprint, are skipped", 0, 0.99},
          grid.min_level_weight);
  };
  const auto option = [](const char* option_name, const Hyperparameter& what) {
    return what.as_option(option_name);
  };
  visit_grid("grid", field.grid, 1, 2, 8);
  visit(
      option("width",
             Hyperparameter{
                 "width", "hidden units of the networks; 64 by default where the scene is bounded",
                 16, kMaxGridWidth}
                 .multiple_of(16)),
      field.width);
  visit({"colour_layers", "hidden layers of the colour network", 1, 2}, field.colour_layers);
  visit(Hyperparameter{"initial_density", "density at first, in units of 1 / contraction.half_m", 0}
            .exclusive(),
        initial_density);
  visit_grid("proposal", proposal, 1, 1, 1);
  visit_grid("sky", sky, 0, 4, 4);  // 0 levels: no sky
  visit({"background", "grey behind rays where there is no sky", 0, 1}, background);
  visit(
      Hyperparameter{"huber_delta",
                     "threshold of the Huber loss for colours in [0, 1]; 2 and more: squared error",
                     0}
          .exclusive(),
      huber_delta);
  visit(Hyperparameter{"appearance.cameras", "cameras with an exposure", 0, 1024}.from_recording(),
        appearance.cameras);
  visit(
      {"appearance.knots", "knots of each camera's exposure over time; 0: no exposure", 0, 100'000},
      appearance.knots);
  visit({"appearance.regulariser_weight", "weight of the mean square of the exposures' log gains",
         0, 1},
        appearance.regulariser_weight);
  constexpr const char* kCenter = "centre of the near region, m";
  visit({"contraction.center_x", kCenter}, contraction.center[0]);
  visit({"contraction.center_y", kCenter}, contraction.center[1]);
  visit({"contraction.center_z", kCenter}, contraction.center[2]);
  visit(Hyperparameter{"contraction.half_m", "half the side of the near region, m", 0}.exclusive(),
        contraction.half_m);
  int unbounded = contraction.unbounded;
  visit({"contraction.unbounded", "1: space outside the near region is contracted; 0: it is empty",
         0, 1},
        unbounded);
  contraction.unbounded = unbounded != 0;
  visit(Hyperparameter{"near_m", "first sample of a ray, m", 0}.exclusive().from_recording(),
        spacing.near_m);
  visit(Hyperparameter{"far_m", "last sample of a ray, m", 0}.exclusive().from_recording(),
        spacing.far_m);
  visit(
      Hyperparameter{"spacing.half_m", "half of the uniform samples lie within, m", 0}.exclusive(),
      spacing.half_m);
  visit({"proposal_samples_1", "samples of a ray in the first proposal iteration", 1, 1024},
        proposal_samples[0]);
  visit({"proposal_samples_2", "samples of a ray in the second proposal iteration", 1, 1024},
        proposal_samples[1]);
  visit(option("samples",
               {"samples", "final samples of a ray, at which the field is evaluated", 1, 1024}),
        samples);
  visit(Hyperparameter{"histogram_padding", "added to the proposals' histogram before PDF sampling",
                       0, 1000}
            .exclusive(),
        histogram_padding);
  visit({"min_proposal_footprint",
         "least side of a proposal sample's volume, of the interval's length", 0, 10},
        min_proposal_footprint);
  visit({"rays_per_proposal_ray", "one ray of so many trains the proposals", 1, 1024},
        rays_per_proposal_ray);
  visit({"compaction.min_opacity", "rays below this proposal opacity are not evaluated", 0, 1},
        min_active_opacity);
  visit({"compaction.keep_probability", "share of those rays that training evaluates all the same",
         0, 1},
        keep_probability);
  visit({"sparsity_weight", "weight of the sparsity regulariser", 0, 1}, sparsity_weight);
  visit({"proposal_opacity_weight", "weight of the opacity term of the proposals' loss", 0, 1000},
        proposal_opacity_weight);
  visit({"range_weight", "weight of the LiDAR loss", 0, 1000}, range_weight);
  visit(Hyperparameter{"range_spread.first_m",
                       "standard deviation of a return in the LiDAR loss at step 0, m", 0}
            .exclusive(),
        first_range_spread_m);
  visit(Hyperparameter{"range_spread.last_m", "least standard deviation of a return, m", 0}
            .exclusive(),
        last_range_spread_m);
  visit(Hyperparameter{"range_spread.half_life", "steps in which the standard deviation halves", 0}
            .exclusive(),
        range_spread_half_life);
  visit_batch(visit);
  visit(Hyperparameter{"max_batch_factor",
                       "rays of a step at most, of batch_rays, where part of them are not active",
                       1, 16},
        max_batch_factor);
  visit(
      option(
          "error-rays",
          {"error_rays",
           "share of the rays that is drawn by the error map, up to 8 times as often as uniformly; "
           "the others see every pixel once an epoch",
           0, 0.9}),
      error_rays);
  visit(option(
            "lidar-rays",
            {"lidar_rays", "LiDAR rays of a step besides, where there are any; 0: none", 0, 65536}),
        lidar_rays);
  visit(
      option(
          "learning-rate",
          Hyperparameter{"learning_rate", "learning rate of Adam at the start", 0, 1}.exclusive()),
      initial_rate);
  visit(option("lr-gamma",
               Hyperparameter{"lr_gamma", "factor of the learning rate at the end of the run", 0, 1}
                   .exclusive()),
        rate_gamma);
  visit({"warm_up_steps", "steps in which the learning rate rises linearly", 0, 1e9},
        warm_up_steps);
  visit({"adam.beta2", "decay of Adam's second moment", 0, 0.999999}, beta2);
  visit(Hyperparameter{"adam.epsilon", "epsilon of Adam", 0, 1}.exclusive(), epsilon);
}

void GridModel::visit_state(HyperparameterVisitor& visit) {
  visit({"active_fraction", "smoothed share of the rays that the field is evaluated on", 0, 1},
        active_fraction);
}

void GridModel::check(const HyperparameterFailure& fail) const {
  const auto check_grid = [&](const std::string& name, const HashGridConfig& grid) {
    if (grid.max_resolution < grid.base_resolution)
      fail({name + ".max_resolution", ""}, std::to_string(grid.max_resolution),
           "must not be below base_resolution");
  };
  check_grid("grid", field.grid);
  check_grid("proposal", proposal);
  if (sky.n_levels > 0) check_grid("sky", sky);
  const int features = field.grid.features_per_level;
  if (features != 2 && features != 4 && features != 8)
    fail({"grid.features_per_level", ""}, std::to_string(features), "must be 2, 4 or 8");
  if (field.grid.outputs() % 16 != 0)
    fail({"grid.n_levels", ""}, std::to_string(field.grid.n_levels),
         "times features_per_level must be a multiple of 16");
  if (!(spacing.far_m > spacing.near_m))
    fail({"far_m", ""}, std::to_string(spacing.far_m), "must be above near_m");
  check_batch(samples, fail);
}

double GridModel::learning_rate(const Schedule& at) const {
  return exponential_decay_rate(initial_rate, rate_gamma, std::min(at.progress, 1.0), at.step,
                                warm_up_steps);
}

std::string GridModel::describe_schedule(std::int64_t) const {
  char text[100];
  std::snprintf(text, sizeof text, "learning rate %g, in the end times %g", initial_rate,
                rate_gamma);
  return text;
}

std::vector<LossTerm> GridModel::loss_terms(const StepSums& sums) const {
  return {{"colour", sums.terms[kColourLoss]},
          {"sparsity", sums.terms[kSparsityLoss]},
          {"proposal", sums.terms[kProposalLoss] + sums.terms[kProposalLoss + 1]},
          {"lidar", sums.terms[kLidarLoss], /*in_loss=*/false}};
}

int GridModel::rays_per_step() const {
  const double factor =
      active_fraction * max_batch_factor > 1 ? 1 / active_fraction : max_batch_factor;
  return static_cast<int>(batch_rays * factor);
}

void GridModel::finish_step(kernels::Backend&, const StepRequest&, const StepOutput& output,
                            std::int64_t, const StepBuffers&, AdamState*) {
  constexpr double kSmoothing = 1.0 / 32;  // per step
  if (output.active_rays > 0)
    active_fraction +=
        kSmoothing * (static_cast<double>(output.active_rays) / output.pixels - active_fraction);
}

namespace {

/// Margin of the near region around all cameras. Pixels (1/500 rad) of surfaces further from every
/// camera are several centimetres wide, which the contraction's coarser cells still resolve.
constexpr double kNearPadding_m = 25;

/// Half of an unbounded ray's first samples lie within this many half sides of the near region, as
/// for drives.
constexpr float kHalfSpacing = 3;

}  // namespace

void GridModel::configure(const Scene& scene) {
  Eigen::AlignedBox3d cameras;
  for (const View& view : scene.views) cameras.extend(scene.world_from_camera(view).translation());
  for (int k = 0; k < 3; ++k) contraction.center[k] = static_cast<float>(cameras.center()[k]);
  contraction.half_m = static_cast<float>(cameras.sizes().maxCoeff() / 2 + kNearPadding_m);
  if (scene.half_side) {  // the world's origin is its centre
    const auto half = static_cast<float>(*scene.half_side);
    const bool from_within = std::ranges::any_of(scene.views, [&](const View& view) {
      return scene.world_from_camera(view).translation().cwiseAbs().maxCoeff() < half;
    });
    // Photographs from inside the cube also show the space beyond it.
    const bool unbounded = from_within && scene.background == Background::kNone;
    contraction = {{0, 0, 0}, half, unbounded};
    spacing.half_m = kHalfSpacing * half;
    if (!unbounded) configure_bounded();
  }
  if (scene.background != Background::kNone) {
    sky.n_levels = 0;
    background = background_colour(scene.background)[0];
  }
  if (!scene.metric) huber_delta = 2;  // photographs of a static scene: least squares
  if (scene.metric) {
    const double seconds = scene.exposure(0, scene.frames.back().t_ns).t_s;
    appearance.cameras = static_cast<int>(scene.rig.size());
    appearance.knots = static_cast<int>(std::ceil(seconds / kKnotSpacing_s)) + 1;
  }
  spacing.near_m = static_cast<float>(scene.near_m);
  spacing.far_m = static_cast<float>(scene.far_m);
}

/// Sets values for scenes inside a cube, chosen by measurement (docs/experiments.md).
void GridModel::configure_bounded() {
  field.width = 64;
  field.grid.max_resolution = 1024;  // seen from outside, a thousand pixels span the cube
  field.colour_layers = 2;           // specular surfaces, seen from all sides
  histogram_padding = 0.4f;          // several surfaces along a ray, without LiDAR
  // Thin structures: a proposal sample covers its whole interval.
  min_proposal_footprint = 0.3f;
  proposal_samples[1] = 64;
  sparsity_weight = 1e-4f;  // regions behind and below that few views see
}

}  // namespace redrive
