// SPDX-License-Identifier: Apache-2.0
// The composition of the stages, which have their own tests. (Both losses and networks:
// train/step_test.cc.)
#include "redrive/methods/nerf/nerf_model.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/methods/grid/tiny_grid_model_testing.h"

namespace redrive {
namespace {

/// Rays through the cube, most of which hit something.
RayBatch rays_through_cube(int n) {
  RayBatch batch;
  batch.n = n;
  batch.direction.resize(3 * n);
  for (int i = 0; i < 3 * n; ++i) {
    batch.origin.push_back(static_cast<float>(0.5 * uniform(32, i)));
    batch.target.push_back(static_cast<float>(0.5 + 0.5 * uniform(33, i)));
  }
  for (int ray = 0; ray < n; ++ray) {
    const double yaw = 3 * uniform(34, ray), up = 0.5 * uniform(35, ray);
    const double d[3] = {std::cos(yaw) * std::cos(up), std::sin(yaw) * std::cos(up), std::sin(up)};
    for (int k = 0; k < 3; ++k) batch.direction[k * n + ray] = static_cast<float>(d[k]);
  }
  return batch;
}

/// Densities of about 0.3 and colours that do not depend on the direction. Coarse densities are
/// constant, so that the fine samples do not move relative to a ray.
void make_tiny_nerf(NerfModel& model, int fine_samples) {
  model.config = {32, 3, 2};
  model.samples = 6;
  model.fine_samples = fine_samples;
  model.far_m = 6;
  model.unit_from_world = {{0.25f, -0.5f, 0}, 0.15f};
  model.initialize(4);
  const NerfLayerShape density = nerf_layer(model.config, kNerfDensity),
                       colour = nerf_layer(model.config, kNerfColour);
  for (int network = 0; network < model.networks(); ++network) {
    float* const numbers = &model.parameters[network * nerf_parameter_count(model.config)];
    numbers[density.bias] = 0.3f;
    if (network == 0 && fine_samples > 0)
      std::fill_n(numbers + density.weight, density.inputs, 0.0f);
    for (int o = 0; o < colour.outputs; ++o) {
      float* const row = numbers + colour.weight + static_cast<std::size_t>(o) * colour.inputs;
      std::fill(row + model.config.width, row + colour.inputs, 0.0f);
    }
  }
}

TEST(NerfModelGradients, OfRaysMatchTheLoss) {
  const auto backend = kernels::make_ref_backend();
  for (const int fine_samples : {0, 5}) {
    NerfModel model;
    make_tiny_nerf(model, fine_samples);
    RayBatch batch = rays_through_cube(12);
    batch.refines = true;
    std::vector<float> gradients(model.size()), ignored(gradients);
    Workspace workspace;
    const RayGradientsOutput losses = model.gradients(*backend, batch, 9, 3, gradients, &workspace);
    ASSERT_EQ(losses.d_origin.size(), 36u);
    ASSERT_EQ(losses.d_direction.size(), 36u);
    constexpr float h = 0x1p-11f;
    for (const bool turns : {false, true}) {
      const std::vector<float>& d = turns ? losses.d_direction : losses.d_origin;
      // Differences along the derivative itself, which is large against the effect of a few ReLU
      // kinks.
      double squares = 0;
      for (const float each : d) squares += double(each) * each;
      const double norm = std::sqrt(squares);
      RayBatch moved[2] = {batch, batch};
      for (std::size_t i = 0; i < d.size(); ++i)
        for (const int side : {0, 1})
          (turns ? moved[side].direction : moved[side].origin)[i] +=
              static_cast<float>((side ? 6 : -6) * h * d[i] / norm);  // 36 numbers: about h each
      const auto loss = [&](const RayBatch& rays) {
        model.gradients(*backend, rays, 9, 3, ignored, &workspace);
        return workspace.sums().terms[0] + workspace.sums().rgb_mse;
      };
      const double difference = (loss(moved[1]) - loss(moved[0])) / (2 * 6 * h);
      EXPECT_NEAR(difference, norm, 0.05 * norm) << fine_samples << (turns ? " turned" : " moved");
      EXPECT_GT(norm, 100 * 0x1p-25 / (6 * h)) << "below the rounding of the loss";
    }
    batch.refines = false;
    std::vector<float> of_field(model.size());
    EXPECT_TRUE(model.gradients(*backend, batch, 9, 3, of_field, &workspace).d_origin.empty());
    EXPECT_EQ(of_field, gradients) << "ray derivatives do not change those of the field";
  }
}

}  // namespace
}  // namespace redrive
