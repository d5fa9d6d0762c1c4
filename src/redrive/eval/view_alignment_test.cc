// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/view_alignment.h"
#include "redrive/image/image_io.h"

#include <functional>

#include <gtest/gtest.h>

#include "redrive/methods/grid/tiny_grid_model_testing.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/render/renderer.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

std::unique_ptr<Trainee> grid_model(const Scene&) {
  auto model = std::make_unique<GridModel>();
  make_tiny(*model);
  model->appearance = {};
  model->samples = 12;
  model->proposal_samples = {24, 16};
  return model;
}

/// Has strong colours that do not depend on the view. A single network, because two untrained ones
/// would render different images.
std::unique_ptr<Trainee> nerf_model(const Scene& scene) {
  auto model = std::make_unique<NerfModel>();
  model->config = {32, 4, 1};
  model->samples = 48;
  model->far_m = 12;
  model->unit_from_world = scene.unit_from_world;
  model->initialize(4);
  const NerfLayerShape density = nerf_layer(model->config, kNerfDensity),
                       rgb = nerf_layer(model->config, kNerfRgb),
                       colour = nerf_layer(model->config, kNerfColour);
  Buffer<float>& numbers = model->parameters;
  numbers[density.bias] = 0.2f;
  for (std::size_t i = rgb.weight; i < rgb.bias; ++i) numbers[i] *= 12;
  for (int o = 0; o < colour.outputs; ++o)
    std::fill_n(
        &numbers[colour.weight + static_cast<std::size_t>(o) * colour.inputs + model->config.width],
        encoded_size(model->config.direction_octaves), 0.0f);
  return model;
}

// Perturbed poses of images rendered from a field converge back to their poses; other views stay.
void expect_to_be_found(
    const std::function<std::unique_ptr<Trainee>(const Scene&)>& model_of_scene) {
  const TemporaryFolder folder;
  redrive::Run run;
  run.recording = make_test_recording(folder.path);
  SceneOptions options;
  options.holdout_every = 3;
  run.scene = make_scene(run.recording, options);
  run.state.model = model_of_scene(run.scene);

  const auto backend = kernels::make_backend({});
  std::vector<std::size_t> held_out;
  for (std::size_t v = 0; v < run.scene.views.size(); ++v) {
    const View& view = run.scene.views[v];
    if (!view.held_out) continue;
    held_out.push_back(v);
    write_image(view.image, to_image8(render_image(*backend, *run.state.model,
                                                   run.scene.rig[view.camera].camera,
                                                   run.scene.world_from_camera(view))));
  }
  ASSERT_EQ(held_out.size(), 4u);
  Exclusions left_out{{}, MovingObjects({}, run.recording.frames, run.scene.global_from_world)};
  for (const RigCamera& rig : run.scene.rig)
    left_out.masks.push_back(full_mask(rig.camera.width, rig.camera.height));

  const Scene ground_truth = run.scene;
  const float aside[6] = {0.06f, -0.05f, 0.04f, 0.012f, -0.01f, 0.015f};
  for (View& view : run.scene.views) view.motion = rigid_from_vector(aside);
  Scene scene = run.scene;
  const ViewAlignment found = align_views(run, *backend, held_out, left_out, &scene);
  EXPECT_EQ(found.views, 4);
  const auto off = [&](const Scene& of, std::size_t v) {
    const Rigid3d residual = ground_truth.world_from_body(ground_truth.views[v]).inverse() *
                             of.world_from_body(of.views[v]);
    return residual.translation().norm() +
           5 * Eigen::AngleAxisd(residual.linear()).angle();  // at 5 m
  };
  double before = 0, after = 0;
  for (const std::size_t v : held_out) {
    before += off(run.scene, v);
    after += off(scene, v);
  }
  // Limited by 8-bit values of three hundred pixels, half of them nearly empty.
  EXPECT_LT(after, before / 2);
  EXPECT_GT(found.translation_m, 0.02);
  EXPECT_GT(found.rotation_deg, 0.3);
  for (std::size_t v = 0; v < scene.views.size(); ++v)
    if (!scene.views[v].held_out) {
      EXPECT_EQ(off(scene, v), off(run.scene, v));
    }
}

TEST(ViewAlignment, RecoversPosesOfImagesOfAGrid) { expect_to_be_found(grid_model); }

TEST(ViewAlignment, RecoversPosesOfImagesOfANerf) { expect_to_be_found(nerf_model); }

}  // namespace
}  // namespace redrive
