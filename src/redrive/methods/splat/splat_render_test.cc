// SPDX-License-Identifier: Apache-2.0
// Images that method splat renders of known Gaussians.
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive::known_splats {
namespace {

TEST(SplatRender, ScalesColoursByTheExposureAndGivesRanges) {
  KnownScene known;
  known.scene.metric = true;
  const auto backend = fast_backend();
  SplatModel model;
  model.configure(known.scene);
  set_gaussians(known_gaussians(120), &model);
  float* const knots = model.parameters.data() + gaussian_blocks(120) * kBlockSize;
  for (int c = 0; c < 3; ++c) knots[c] = std::log(0.5f + 0.1f * c) / kLogGainScale;
  const View& view = known.scene.views[0];
  const RayTable rays = make_ray_table(known.scene.rig[0].camera);
  const RenderedImage plain = model.render(*backend, rays, known.scene.shutter_poses(view), {}),
                      exposed = model.render(*backend, rays, known.scene.shutter_poses(view),
                                             known.scene.exposure(view));
  int near = 0;
  for (std::size_t i = 0; i < plain.depth.size(); ++i) {
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(exposed.rgb[3 * i + c], (0.5f + 0.1f * c) * plain.rgb[3 * i + c], 1e-5);
    if (plain.opacity[i] < 0.9f) continue;
    ++near;
    EXPECT_GT(plain.depth[i], 2);
    EXPECT_LT(plain.depth[i], 8);
  }
  EXPECT_GT(near, 100);
}

TEST(SplatRender, MemoryOfAnotherImageChangesNoPixel) {
  KnownScene known;
  // A fisheye's corners are outside its valid region.
  known.scene.rig[0].camera =
      make_camera({"FISHEYE", "mei", {60, 60, 49.5, 39.5, 0, 0, 0, 0, 0, 1.5}, 100, 80});
  const auto backend = fast_backend();
  SplatModel model;
  model.configure(known.scene);
  set_gaussians(known_gaussians(120), &model);
  const RayTable rays = make_ray_table(known.scene.rig[0].camera);
  ASSERT_LT(rays.pixel.size(), std::size_t{100 * 80});
  const ShutterPoses poses = known.scene.shutter_poses(known.scene.views[0]);
  const RenderedImage expected = model.render(*backend, rays, poses, {});
  RenderedImage used;
  used.resize(130, 120);
  std::ranges::fill(used.rgb, 0.7f);
  std::ranges::fill(used.depth, 7.0f);
  std::ranges::fill(used.opacity, 0.7f);
  std::ranges::fill(used.valid, std::uint8_t{1});
  model.render_to(*backend, rays, poses, {}, &used);
  EXPECT_EQ(used.width, 100);
  EXPECT_EQ(used.height, 80);
  EXPECT_EQ(used.rgb, expected.rgb);
  EXPECT_EQ(used.depth, expected.depth);
  EXPECT_EQ(used.opacity, expected.opacity);
  EXPECT_EQ(used.valid, expected.valid);
  EXPECT_EQ(std::ranges::count(used.valid, 1), std::ssize(rays.pixel));
  for (std::size_t i = 0; i < used.valid.size(); ++i)
    if (!used.valid[i]) {
      EXPECT_EQ(used.rgb[3 * i] + used.depth[i] + used.opacity[i], 0) << i;
    }
}

}  // namespace
}  // namespace redrive::known_splats
