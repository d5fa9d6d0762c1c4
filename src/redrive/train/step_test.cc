// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/methods/grid/grid_model.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

RayBatch example_batch(int n) {
  RayBatch batch;
  batch.n = n;
  batch.origin.assign(3 * n, 0.0f);
  batch.direction.resize(3 * n);
  batch.target.resize(3 * n);
  for (int i = 0; i < n; ++i) {
    const float angle = 0.2f * (random_unit(kStreamTest, i) - 0.5f);
    batch.direction[i] = std::cos(angle);
    batch.direction[n + i] = std::sin(angle);
    batch.direction[2 * n + i] = 0;
    for (int k = 0; k < 3; ++k) batch.target[k * n + i] = random_unit(kStreamTest + 1, 3 * i + k);
  }
  return batch;
}

TrainState small_state(int fine_samples) {
  Scene scene;
  scene.near_m = 1;
  scene.far_m = 5;
  scene.unit_from_world = {{0, 0, 0}, 0.2f};
  TrainOptions options = tiny_options(1);
  options.set("samples", 8);
  options.set("fine_samples", fine_samples);
  options.seed = 5;
  return make_initial_state(options, scene);
}

TEST(TrainStep, IsTheCompositionOfThePlainStages) {
  const auto backend = kernels::make_ref_backend();
  const RayBatch batch = example_batch(16);
  TrainState state = small_state(0);
  const TrainState before = parse_checkpoint(checkpoint_bytes(state), "");
  StepBuffers buffers;
  const StepResult result = train_step(*backend, batch, 1e-3, &state, &buffers);
  for (const float left : buffers.gradients.span())
    ASSERT_EQ(left, 0);  // the next step adds to the gradients
  std::vector<float> gradients(before.model->size());
  Workspace workspace;
  nerf(before).gradients(*backend, batch, before.seed, 0, gradients, &workspace);

  // Reference: sample, render, squared error; then Adam's first step, which changes each weight by
  // lr g / (|g| + eps).
  std::vector<float> t(16 * 8), dt(16 * 8), rgb(48), depth(16), opacity(16);
  backend->nerf().sample_stratified(16, {8, 1, 5, true, random_key(5, kStreamSamples, 0)}, t, dt);
  backend->nerf().render_rays(nerf(before).field(0), {16, batch.origin, batch.direction},
                              {8, t, dt}, {rgb, depth, opacity, {}});
  double loss = 0, mean_opacity = 0;
  for (int i = 0; i < 48; ++i) loss += std::pow(double(rgb[i]) - batch.target[i], 2) / 48;
  for (const float value : opacity) mean_opacity += value / 16.0;
  EXPECT_NEAR(result.loss, loss, 48 * 1.2e-7 * loss);
  EXPECT_EQ(result.rgb_mse, result.loss);
  EXPECT_NEAR(result.opacity, mean_opacity, 1e-6);
  EXPECT_TRUE(result.finite);
  EXPECT_EQ(state.step, 1);
  int moved = 0;
  for (std::size_t i = 0; i < state.model->parameters.size(); ++i) {
    const double gradient = gradients[i],
                 step = state.model->parameters[i] - before.model->parameters[i];
    // Bounds one rounding of the parameter (|p| < 1) and a few of the quotient.
    EXPECT_NEAR(step, -1e-3 * gradient / (std::abs(gradient) + 1e-8), 1.2e-7 + 1e-3 * 1e-4) << i;
    moved += step != 0;
  }
  EXPECT_GT(moved, static_cast<int>(state.model->parameters.size() / 4));
}

TEST(TrainStep, HierarchicalAddsTheLossesAndTrainsBothNetworks) {
  const auto backend = kernels::make_ref_backend();
  const RayBatch batch = example_batch(8);
  TrainState state = small_state(12);
  const TrainState before = parse_checkpoint(checkpoint_bytes(state), "");
  StepBuffers buffers;
  const StepResult result = train_step(*backend, batch, 1e-3, &state, &buffers);
  TrainState coarse_only = small_state(0);
  StepBuffers other;
  const StepResult coarse = train_step(*backend, batch, 1e-3, &coarse_only, &other);
  EXPECT_NEAR(result.loss, coarse.loss + result.rgb_mse, 1e-6 * result.loss);
  EXPECT_TRUE(bit_equal(nerf(state).network(0), nerf(coarse_only).network(0)))
      << "no gradient flows through the fine samples";
  EXPECT_FALSE(bit_equal(nerf(state).network(1), nerf(before).network(1)));
}

TEST(TrainStep, BatchesOfAnySizeShareTheBuffers) {  // the last batch of an epoch is smaller
  const auto backend = kernels::make_ref_backend();
  TrainState shared = small_state(4), fresh = small_state(4);
  StepBuffers buffers;
  for (const int n : {16, 3, 16}) {
    StepBuffers own;
    const StepResult a = train_step(*backend, example_batch(n), 1e-3, &shared, &buffers);
    const StepResult b = train_step(*backend, example_batch(n), 1e-3, &fresh, &own);
    EXPECT_EQ(a.loss, b.loss) << n;
  }
  EXPECT_TRUE(same_weights(shared, fresh));
}

TEST(TrainStep, SkipsANonFiniteStep) {
  const auto backend = kernels::make_ref_backend();
  RayBatch batch = example_batch(4);
  batch.target[5] = std::numeric_limits<float>::quiet_NaN();
  TrainState state = small_state(0);
  const TrainState before = parse_checkpoint(checkpoint_bytes(state), "");
  StepBuffers buffers;
  EXPECT_FALSE(train_step(*backend, batch, 1e-3, &state, &buffers).finite);
  EXPECT_TRUE(same_weights(state, before));
  EXPECT_EQ(state.step, 1);
}

TEST(TrainStep, SkipsANonFiniteStepOfEveryPartOfAGrid) {
  const auto backend = kernels::make_ref_backend();
  RayBatch batch = example_batch(8);
  batch.pixel_angle.assign(8, 0.01f);
  const auto fresh = [] {
    auto model = std::make_unique<GridModel>();
    model->field = {{2, 8, 2, 8, 6}, 16, 2};
    model->proposal = {1, 1, 4, 4, 8};
    model->sky = {1, 4, 2, 2, 6};
    return initial_state(std::move(model), 3);
  };
  TrainState good = fresh();
  StepBuffers buffers;
  EXPECT_TRUE(train_step(*backend, batch, 1e-2, &good, &buffers).finite);
  EXPECT_FALSE(same_weights(good, fresh()));
  for (const ModelTensor& tensor : good.model->tensors()) {
    std::size_t size = 1;
    for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
    TrainState state = fresh();
    std::fill_n(&state.model->parameters[tensor.offset], size,
                std::numeric_limits<float>::quiet_NaN());
    const std::string before = checkpoint_bytes(state);
    EXPECT_FALSE(train_step(*backend, batch, 1e-2, &state, &buffers).finite) << tensor.name;
    state.step = 0;
    state.pixels_drawn = 0;
    EXPECT_EQ(checkpoint_bytes(state), before) << tensor.name;
    for (const float left : buffers.gradients.span()) ASSERT_EQ(left, 0) << tensor.name;
  }
}

TEST(TrainStep, UpdatesTheErrorMapByItsRays) {
  const auto backend = kernels::make_ref_backend();
  RayBatch batch = example_batch(8);
  batch.pixel_angle.assign(8, 0.01f);
  batch.error_map_rays = 3;
  batch.cell = {0, 1, 2, 3, 4, 5, 6, 6};
  auto model = std::make_unique<GridModel>();
  model->field = {{2, 8, 2, 8, 6}, 16, 2};
  model->proposal = {1, 1, 4, 4, 8};
  model->sky = {1, 4, 2, 2, 6};
  TrainState state = initial_state(std::move(model), 3);
  state.cell_errors = Buffer<float>(9);
  std::ranges::fill(state.cell_errors.span(), kInitialError);
  StepBuffers buffers;
  const StepResult result = train_step(*backend, batch, 0, &state, &buffers);
  EXPECT_EQ(state.pixels_drawn, 5u);
  ASSERT_EQ(result.squared_errors.size(), 8u);
  double even = 0;
  for (int i = 0; i < 5; ++i) even += result.squared_errors[i] / 5.0;
  EXPECT_NEAR(result.rgb_mse, even, 1e-6 * even);
  std::vector<float> expected(9, kInitialError);
  update_error_map(batch.cell, result.squared_errors, expected);
  EXPECT_TRUE(bit_equal(state.cell_errors, expected));
  EXPECT_LT(expected[6], kInitialError);
  EXPECT_EQ(expected[7], kInitialError);

  batch.target[5] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(train_step(*backend, batch, 1e-2, &state, &buffers).finite);
  EXPECT_TRUE(bit_equal(state.cell_errors, expected));
  EXPECT_EQ(state.pixels_drawn, 10u);
}

TEST(TrainStep, CountsTheActiveRays) {
  const auto backend = kernels::make_ref_backend();
  RayBatch batch = example_batch(64);
  batch.pixel_angle.assign(64, 0.01f);
  auto model = std::make_unique<GridModel>();
  model->field = {{2, 8, 2, 8, 6}, 16, 2};
  model->proposal = {1, 1, 4, 4, 8};
  model->sky = {1, 4, 2, 2, 6};
  TrainState state = initial_state(std::move(model), 3);
  StepBuffers buffers;
  EXPECT_EQ(train_step(*backend, batch, 0, &state, &buffers).active_rays, 64);
  const auto& grid = dynamic_cast<const GridModel&>(*state.model);
  EXPECT_EQ(grid.active_fraction, 1);
  for (const ModelTensor& tensor : state.model->tensors())
    if (tensor.name == "proposal")
      std::fill_n(&state.model->parameters[tensor.offset], tensor.shape[0], -30.0f);
  const int active = train_step(*backend, batch, 0, &state, &buffers).active_rays;  // one in 16
  EXPECT_LT(active, 16);
  EXPECT_DOUBLE_EQ(grid.active_fraction, 1 + (active / 64.0 - 1) / 32);
}

TEST(TrainStep, DeadFieldHasNoOpacityAndNoGradient) {
  const auto backend = kernels::make_ref_backend();
  TrainState state = small_state(0);
  state.model->parameters[nerf_layer(nerf(state).config, kNerfDensity).bias] = -1e3f;
  const TrainState before = parse_checkpoint(checkpoint_bytes(state), "");
  StepBuffers buffers;
  const StepResult result = train_step(*backend, example_batch(8), 1e-3, &state, &buffers);
  EXPECT_EQ(result.opacity, 0);
  EXPECT_TRUE(bit_equal(state.model->parameters, before.model->parameters));
}

}  // namespace
}  // namespace redrive
