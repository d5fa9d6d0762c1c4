// SPDX-License-Identifier: Apache-2.0
// The composition of the stages, which have their own tests.
#include "redrive/methods/grid/grid_model.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <set>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/field/activation.h"
#include "redrive/methods/grid/tiny_grid_model_testing.h"

namespace redrive {
namespace {

/// Returns a batch of ray `which` only.
RayBatch ray_of(const RayBatch& batch, int which) {
  RayBatch one;
  one.n = 1;
  for (int k = 0; k < 3; ++k) {
    one.origin.push_back(batch.origin[k * batch.n + which]);
    one.direction.push_back(batch.direction[k * batch.n + which]);
    one.target.push_back(batch.target[k * batch.n + which]);
  }
  one.pixel_angle = {batch.pixel_angle[which]};
  if (!batch.exposure.empty()) one.exposure = {batch.exposure[which]};
  return one;
}

struct Rendering {
  std::vector<float> rgb, depth, opacity;

  Rendering(const GridModel& model, const RayBatch& batch)
      : rgb(3 * batch.n), depth(batch.n), opacity(batch.n) {
    Workspace workspace;
    model.render_rays(*kernels::make_ref_backend(), batch, {rgb, depth, opacity, {}}, &workspace);
  }
};

TEST(GridModel, RendersWithoutRandomNumbers) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(7);
  const Rendering once(model, batch), again(model, batch);
  EXPECT_EQ(once.rgb, again.rgb);
  EXPECT_EQ(once.depth, again.depth);
  EXPECT_EQ(once.opacity, again.opacity);
  double spread = 0;
  for (int ray = 0; ray < batch.n; ++ray) {
    // Independent of the other rays of a batch.
    const Rendering alone(model, ray_of(batch, ray));
    EXPECT_EQ(alone.depth[0], once.depth[ray]);
    EXPECT_EQ(alone.opacity[0], once.opacity[ray]);
    for (int k = 0; k < 3; ++k) EXPECT_EQ(alone.rgb[k], once.rgb[k * batch.n + ray]);
    EXPECT_GE(once.depth[ray], 0.5f);
    EXPECT_LE(once.depth[ray], 20.01f);
    EXPECT_GT(once.opacity[ray], 0);
    EXPECT_LE(once.opacity[ray], 1);
    spread = std::max(spread, std::abs(double(once.rgb[ray]) - once.rgb[0]));
  }
  EXPECT_GT(spread, 0.01) << "all rays equal: nothing tested";
}

TEST(GridModel, TracesRaysAsLidarBeams) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(7);
  batch.pixel_angle.assign(7, kLidarBeamAngle_rad);
  const Rendering beams(model, batch);
  const RenderedRays traced = model.trace(*kernels::make_ref_backend(), rays_of(batch));
  EXPECT_EQ(traced.depth, beams.depth);
  EXPECT_EQ(traced.opacity, beams.opacity);
}

TEST(GridModel, NeighboursShareTheirFirstProposalIteration) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  // Two groups of rays 1e-3 rad apart, a single ray, and two more; each group around its first ray.
  batch.group = {0, 4, 5, 8};
  for (const auto& [first, last] : {std::pair(0, 4), std::pair(5, 8)})
    for (int ray = first + 1; ray < last; ++ray)
      for (int k = 0; k < 3; ++k) {
        batch.origin[k * batch.n + ray] = batch.origin[k * batch.n + first];
        batch.direction[k * batch.n + ray] =
            batch.direction[k * batch.n + first] + 1e-3f * static_cast<float>((ray + k) % 3 - 1);
      }
  RayBatch each = batch;
  each.group.clear();
  const Rendering together(model, batch), apart(model, each);
  double most = 0;
  for (std::size_t i = 0; i < together.rgb.size(); ++i) {
    // The same field at other samples within the same proposal intervals.
    EXPECT_NEAR(together.rgb[i], apart.rgb[i], 0.02) << i;
    most = std::max(most, std::abs(double(together.rgb[i]) - apart.rgb[i]));
  }
  EXPECT_GT(most, 0) << "groups change nothing: nothing tested";
  for (int k = 0; k < 3; ++k)  // single in its group, up to the rounding of the group's direction
    EXPECT_NEAR(together.rgb[k * batch.n + 4], apart.rgb[k * batch.n + 4], 1e-4);
}

TEST(GridModel, HomogeneousMediumInFrontOfAGreySky) {
  // All parameters 0: density exp(-1) / half_m everywhere, all colours 1/2.
  GridModel model;
  make_tiny(model);
  std::ranges::fill(model.parameters.span(), 0.0f);
  model.proposal_samples = {64, 48};
  model.samples = 48;
  const RayBatch batch = tiny_batch(5);
  const Rendering rendered(model, batch);
  const double density = std::exp(-1) / 3, opacity = -std::expm1(-density * 19.5);
  for (int ray = 0; ray < batch.n; ++ray) {
    // The far end of the ray has 20 / 4 times the rounding error of its s, 2e-6 of its length; the
    // sums round 48 times.
    EXPECT_NEAR(rendered.opacity[ray], opacity, 1e-5);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(rendered.rgb[k * batch.n + ray], 0.5, 1e-5);
    // The median depth is -ln(1 - opacity / 2) / density. Each interval has 1/48 of the weight,
    // spread uniformly.
    EXPECT_NEAR(rendered.depth[ray], 0.5 - std::log1p(-opacity / 2) / density, 0.01);
  }
}

/// Makes the field empty.
void make_empty(GridModel& model) {
  std::ranges::fill(model.parameters.span(), 0.0f);
  const auto at = [&](const char* name) {
    for (const ModelTensor& tensor : model.tensors())
      if (tensor.name == name) return &model.parameters[tensor.offset];
    ADD_FAILURE() << name;
    return model.parameters.data();
  };
  // Positive features and a weight that turns them into log densities of at most -1000.
  std::fill_n(at("grid"), hash_grid_size(model.field.grid), 1.0f);
  at("density.0.weight")[0] = 1;
  at("density.1.weight")[0] = -1e5f;
}

TEST(GridModel, AnEmptyFieldShowsTheSky) {
  GridModel model;
  make_tiny(model);
  make_empty(model);
  float* const sky =
      &model.parameters[model.size() - hash_grid_size(model.sky) - model.appearance.size()];
  const float colour[4] = {0.5f, -1, 2, 1000};  // features of a level; the fourth is unused
  for (std::size_t i = 0; i < hash_grid_size(model.sky); ++i) sky[i] = colour[i % 4];
  const RayBatch batch = tiny_batch(5);
  const Rendering rendered(model, batch);
  for (int ray = 0; ray < batch.n; ++ray) {
    EXPECT_EQ(rendered.opacity[ray], 0);
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(rendered.rgb[k * batch.n + ray], sigmoid(2.0 * colour[k]), 1e-6);
  }
}

TEST(GridModel, AnEmptyFieldShowsTheBackgroundWithoutASky) {
  GridModel model;
  make_tiny_on_background(model);
  EXPECT_EQ(model.tensors().back().name, "proposal");
  EXPECT_EQ(error_message_of(model), "");
  make_empty(model);
  RayBatch batch = tiny_batch(5);
  const Rendering rendered(model, batch);
  batch.background = tiny_batch(5).target;
  const Rendering of_batch(model, batch);
  for (int i = 0; i < 15; ++i) {
    EXPECT_EQ(rendered.rgb[i], 0.75f);
    EXPECT_EQ(of_batch.rgb[i], batch.background[i]);
  }
}

TEST(GridModel, BackgroundIsWeightedByTheTransmittance) {
  GridModel model;
  make_tiny_on_background(model);
  RayBatch batch = tiny_batch(6);
  batch.background.assign(18, 0.0f);
  const Rendering black(model, batch);
  batch.background = tiny_batch(6).target;
  const Rendering coloured(model, batch);
  for (int i = 0; i < 18; ++i) {
    EXPECT_NEAR(coloured.rgb[i] - black.rgb[i], (1 - black.opacity[i % 6]) * batch.background[i],
                1e-6);
    EXPECT_GT(black.opacity[i % 6], 0);
    EXPECT_LT(black.opacity[i % 6], 1);
  }
}

TEST(GridModel, RaysThatMissTheCubeShowTheirBackground) {
  GridModel model;
  make_tiny_on_background(model);
  model.contraction = {{1.5f, 0, 0}, 0.8f, false};
  const RayBatch batch = tiny_batch(40);
  const Rendering rendered(model, batch);
  int missed = 0;
  for (int ray = 0; ray < batch.n; ++ray) {
    float origin[3], direction[3];
    for (int k = 0; k < 3; ++k) {
      origin[k] = batch.origin[k * batch.n + ray];
      direction[k] = batch.direction[k * batch.n + ray];
    }
    const RaySpacing within = clip_to_scene(model.spacing, model.contraction, origin, direction);
    const bool misses = within.near_m == within.far_m;
    missed += misses;
    EXPECT_EQ(rendered.opacity[ray] == 0, misses);
    EXPECT_TRUE(std::isfinite(rendered.depth[ray]));
    for (int k = 0; misses && k < 3; ++k) EXPECT_EQ(rendered.rgb[k * batch.n + ray], 0.75f);
  }
  EXPECT_GT(missed, 5);
  EXPECT_LT(missed, 38);
  std::vector<float> gradients(model.size());
  EXPECT_TRUE(
      std::isfinite(losses_of(model, batch, &gradients, *kernels::make_ref_backend()).loss));
  for (const float g : gradients) ASSERT_TRUE(std::isfinite(g));
}

TEST(GridModel, AddsToTheGradients) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::vector<float> once(model.size()), on_top(model.size(), 1.0f);
  const TinyLosses a = losses_of(model, batch, &once, *backend),
                   b = losses_of(model, batch, &on_top, *backend);
  EXPECT_EQ(a.loss, b.loss);
  for (std::size_t i = 0; i < once.size(); ++i)
    ASSERT_NEAR(on_top[i], 1.0 + once[i], 4 * 0x1p-24 * (1 + std::abs(once[i]))) << i;
}

TEST(GridModel, LossOfANaNTargetIsNaN) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  batch.target[5] = std::numeric_limits<float>::quiet_NaN();
  std::vector<float> gradients(model.size());
  EXPECT_TRUE(std::isnan(losses_of(model, batch, &gradients, *kernels::make_ref_backend()).loss));
}

TEST(GridModel, WeightsRaysAndReturnsTheirErrors) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::vector<float> ignored(model.size());
  Workspace workspace;
  const TinyLosses plain = losses_of(model, batch, ignored, *backend, &workspace);
  const std::vector<float> squares(plain.squared_errors.begin(), plain.squared_errors.end());
  ASSERT_EQ(squares.size(), 8u);
  double mean = 0;
  for (const float square : squares) mean += square / 8.0;
  EXPECT_NEAR(plain.rgb_mse, mean, 1e-6 * mean);
  batch.weight.assign(8, 0);
  const double gains = losses_of(model, batch, &ignored, *backend)
                           .colours;  // without the part that keeps gains near 1
  double sum = 0;
  for (int ray = 0; ray < 8; ++ray) {
    batch.weight[ray] = 2;
    const TinyLosses one = losses_of(model, batch, ignored, *backend, &workspace);
    EXPECT_TRUE(std::ranges::equal(one.squared_errors, squares));
    EXPECT_EQ(one.rgb_mse, plain.rgb_mse);
    sum += one.colours - gains;
    batch.weight[ray] = 0;
  }
  EXPECT_NEAR(sum, 2 * (plain.colours - gains), 1e-6 * sum);
  batch.error_map_rays = 5;
  EXPECT_NEAR(losses_of(model, batch, &ignored, *backend).rgb_mse,
              (squares[0] + squares[1] + squares[2]) / 3, 1e-6)
      << "of the uniformly drawn rays";
}

TEST(GridModel, SamplesFollowSeedAndStep) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::set<double> losses;
  Workspace workspace;
  for (const auto& [seed, step] : {std::pair{1, 0}, {1, 1}, {2, 0}, {1, 0}}) {
    std::vector<float> gradients(model.size());
    losses.insert(losses_of(model, batch, gradients, *backend, &workspace, seed, step).loss);
  }
  EXPECT_EQ(losses.size(), 3u);
}

TEST(GridModel, SkipsTheFieldOnEmptyRays) {
  const auto backend = kernels::make_ref_backend();
  constexpr int kRays = 256;
  GridModel model;
  const RayBatch batch = make_half_empty(model, kRays);
  std::vector<float> gradients(model.size());
  const TinyLosses losses = losses_of(model, batch, &gradients, *backend);
  // One in 16 of 128 empty rays is evaluated: 8 with a standard deviation of 2.7.
  EXPECT_GT(losses.active_rays, kRays / 2);
  EXPECT_LT(losses.active_rays, kRays / 2 + 8 + 5 * 3);

  const Rendering rendered(model, batch);
  for (int ray = 0; ray < kRays; ++ray) {
    const Rendering alone(model, ray_of(batch, ray));  // a batch of one ray is never empty
    if (ray % 2) {
      EXPECT_GT(rendered.opacity[ray], 0) << ray;
      EXPECT_EQ(rendered.opacity[ray], alone.opacity[0]) << ray;
      EXPECT_EQ(rendered.depth[ray], alone.depth[0]) << ray;
      for (int k = 0; k < 3; ++k) EXPECT_EQ(rendered.rgb[k * kRays + ray], alone.rgb[k]) << ray;
    } else {
      EXPECT_EQ(rendered.opacity[ray], 0) << ray;
      EXPECT_GT(alone.opacity[0], 0) << ray;
      EXPECT_FLOAT_EQ(rendered.depth[ray], model.spacing.far_m) << ray;
      for (int k = 0; k < 3; ++k) EXPECT_EQ(rendered.rgb[k * kRays + ray], model.background) << ray;
    }
  }
}

}  // namespace
}  // namespace redrive
