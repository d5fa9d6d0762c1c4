// SPDX-License-Identifier: Apache-2.0
// A wall of linear colours, part of which a plate hides in every image.
#include "redrive/methods/splat/actors/fill_hidden.h"

#include <array>
#include <cmath>
#include <cstring>
#include <set>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive::known_splats {
namespace {

constexpr float kWall_m = 8, kHidden_m = 0.9f;  // distance; half side of what is hidden and wrong

/// Flat, opaque Gaussians every `spacing` metres across z, within +-half_x, +-half_y.
template <class Colour>
GaussianList sheet(float half_x, float half_y, float z, float spacing, const Colour& colour) {
  GaussianList list;
  for (float y = -half_y; y <= half_y; y += spacing)
    for (float x = -half_x; x <= half_x; x += spacing) {
      std::array<float, kGaussianRows> rows{};
      rows[kPositionRow] = x;
      rows[kPositionRow + 1] = y;
      rows[kPositionRow + 2] = z;
      for (int k = 0; k < 3; ++k)
        rows[kLogScaleRow + k] = std::log(k == 2 ? 0.001f : 0.7f * spacing);
      rows[kQuaternionRow] = 1;
      rows[kOpacityRow] = 5;
      const std::array<float, 3> rgb = colour(x, y);
      for (int k = 0; k < 3; ++k) rows[kColourRow + k] = rgb[k];
      rows[kDistanceRow] = kWall_m;
      list.rows.insert(list.rows.end(), rows.begin(), rows.end());
    }
  return list;
}

std::array<float, 3> linear(float x, float y) { return {0.5f + 0.08f * x, 0.5f + 0.1f * y, 0.4f}; }

/// The camera drives along x; the plate, half as far away as the wall, half as fast, so that it
/// hides the same part of the wall in all images. That part is magenta.
struct HiddenWall : SplatScene {
  SplatModel truth, model;

  explicit HiddenWall(bool with_free_image = false) {
    add_camera("CAMERA", "opencv_pinhole", {80, 80, 47.5, 31.5, 0, 0, 0, 0, 0}, 96, 64);
    MovingObject plate{.id = 3, .type = "PLATE", .size_m = {1.4, 1.4, 0.2}, .keys = {}};
    for (int i = 0; i < 5; ++i) {
      const double x = 0.2 * (i - 2);
      add_view(0, pose({x, 0, 0}, {0, 0, 0}));
      plate.keys.push_back(
          {scene.frames.back().t_ns, pose({x / 2, 0, kWall_m / 2}, {0, 0, 0}), {1, 0, 0}});
    }
    // The plate is not there a second later.
    if (with_free_image) {
      add_view(0, pose({0, 0, 0}, {0, 0, 0}));
      scene.frames.back().t_ns += 1'000'000'000;
      scene.trajectory.back().t_ns = scene.frames.back().t_ns;
    }
    scene.metric = false;
    scene.actors = {plate};
    finish();
    const GaussianList wall = sheet(6, 5, kWall_m, 0.1f, linear),
                       wrong = sheet(6, 5, kWall_m, 0.1f,
                                     [](float x, float y) {
                                       return std::fabs(x) < kHidden_m && std::fabs(y) < kHidden_m
                                                  ? std::array<float, 3>{1, 0, 1}
                                                  : linear(x, y);
                                     }),
                       front = sheet(0.7f, 0.7f, 0, 0.05f, [](float, float) {
                         return std::array<float, 3>{0.1f, 0.1f, 0.1f};
                       });
    const std::vector<GaussianList> lists{wall, front}, wrong_lists{wrong, front};
    truth.set_gaussians(lists, scene.actors);
    model.set_gaussians(wrong_lists, scene.actors);
  }
  void fill(SplatModel* of, int threads = 2) const {
    AdamState adam = of->zero_moments();
    of->finish_training(*fast_backend(threads), data(), &adam);
    EXPECT_EQ(adam.size(), of->size());
  }
  /// Renders without the plate, from its first training pose but one.
  RenderedImage free(const SplatModel& of) const {
    return of.render(*fast_backend(), make_ray_table(scene.rig[0].camera),
                     scene.world_from_camera(scene.views[1]), {});
  }
};

std::vector<float> copied(const SplatModel& model) {
  return {model.parameters.data(), model.parameters.data() + model.size()};
}

TEST(FillHidden, ContinuesWhatIsSeenAround) {
  HiddenWall wall;
  const std::vector<float> before = copied(wall.model);
  const int n = wall.model.gaussians;
  const RenderedImage expected = wall.free(wall.truth), wrong = wall.free(wall.model);
  wall.fill(&wall.model);
  const RenderedImage filled = wall.free(wall.model);
  int hidden = 0;
  for (std::size_t i = 0; i < expected.depth.size(); ++i) {
    const bool was_wrong = wrong.rgb[3 * i + 1] < 0.2f;
    hidden += was_wrong;
    // A new Gaussian shows up to two standard deviations, 2.8 pixels or 0.28 m, beside its mean,
    // and the colours change by 0.1 a metre; the rest shines through from the wrong ones.
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(filled.rgb[3 * i + c], expected.rgb[3 * i + c], 0.04) << i;
    // A membrane of inverse distances leaves a plane by the curvature of 1 / cos, 0.7 % here.
    EXPECT_NEAR(filled.depth[i] / expected.depth[i], 1, 0.02) << i;
  }
  EXPECT_GT(hidden, 200);
  // Gaussians that are seen stay, bit by bit.
  const auto rows = [](std::span<const float> numbers, int n) {
    std::set<std::array<float, kGaussianRows>> rows;
    for (int i = 0; i < n; ++i) {
      std::array<float, kGaussianRows> own;
      for (int row = 0; row < kGaussianRows; ++row) own[row] = numbers[gaussian_slot(i, row)];
      if (std::hypot(own[kPositionRow], own[kPositionRow + 1]) > 2.4f) rows.insert(own);
    }
    return rows;
  };
  EXPECT_EQ(rows(wall.model.parameters, wall.model.gaussians), rows(before, n));
  EXPECT_GT(rows(before, n).size(), 5000u);
}

TEST(FillHidden, OneImageThatSeesAPlaceKeepsIt) {
  HiddenWall wall(/*with_free_image=*/true);
  const std::vector<float> before = copied(wall.model);
  wall.fill(&wall.model);
  EXPECT_EQ(copied(wall.model), before);
}

TEST(FillHidden, MaskedPixelsSeeNothing) {
  HiddenWall wall(/*with_free_image=*/true);
  wall.images.back().used.assign(std::size_t{96} * 64, 0);
  const std::vector<float> before = copied(wall.model);
  wall.fill(&wall.model);
  EXPECT_NE(copied(wall.model), before);
}

TEST(FillHidden, IsDoneOnceAndTheSameByAnyNumberOfThreads) {
  HiddenWall wall;
  SplatModel& model = wall.model;
  const std::vector<float> before = copied(model);
  wall.fill(&model, 1);
  const std::vector<float> once = copied(model);
  EXPECT_NE(once, before);
  wall.fill(&model, 1);
  EXPECT_EQ(copied(model), once);
  HiddenWall other;
  other.fill(&other.model, 3);
  EXPECT_EQ(std::memcmp(copied(other.model).data(), once.data(), once.size() * sizeof(float)), 0);
  // The next step begins anew.
  AdamState adam = model.zero_moments();
  model.finish_step(*fast_backend(1), {}, {}, 1, {}, &adam);
  EXPECT_EQ(model.filled, 0);
}

}  // namespace
}  // namespace redrive::known_splats
