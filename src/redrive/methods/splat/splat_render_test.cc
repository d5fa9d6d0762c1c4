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

// Each line is nearly the same as in an image of a camera that stands where the line is exposed.
TEST(SplatRender, ShuttersRollByRowOrByColumn) {
  KnownScene known;
  const auto backend = fast_backend();
  SplatModel model;
  model.configure(known.scene);
  set_gaussians(known_gaussians(120), &model);
  const RayTable rays = make_ray_table(known.scene.rig[0].camera);
  const Rigid3d first = known.scene.world_from_camera(known.scene.views[0]),
                last = first * Eigen::Translation3d(0.4, 0.1, 0);
  const auto difference = [&](bool by_column, bool rendered_by_column) {
    const ShutterPoses poses({first, last}, by_column);
    const RenderedImage image =
        model.render(*backend, rays, ShutterPoses({first, last}, rendered_by_column), {});
    const int lines = by_column ? image.width : image.height;
    double sum = 0;
    for (int line = 0; line < lines; ++line) {
      const RenderedImage still =
          model.render(*backend, rays, ShutterPoses(poses.at((line + 0.5) / lines)), {});
      for (int i = 0; i < (by_column ? image.height : image.width); ++i) {
        const int pixel = by_column ? i * image.width + line : line * image.width + i;
        for (int c = 0; c < 3; ++c)
          sum += std::abs(image.rgb[3 * pixel + c] - still.rgb[3 * pixel + c]);
      }
    }
    return sum / static_cast<double>(image.rgb.size());
  };
  for (const bool by_column : {false, true}) {
    const double right = difference(by_column, by_column),
                 wrong = difference(by_column, !by_column);
    EXPECT_LT(right, 0.02) << by_column;
    EXPECT_GT(wrong, 3 * right) << by_column;
  }
}

}  // namespace
}  // namespace redrive::known_splats
