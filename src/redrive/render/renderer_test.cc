// SPDX-License-Identifier: Apache-2.0
// The geometry of rendering, with a backend whose image is a formula: the colour of a ray is its
// direction.
#include "redrive/render/renderer.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/nerf/nerf_model.h"

#include "redrive/render/paint_backend_testing.h"

namespace redrive {
namespace {

constexpr int kSamples = 96, kFineSamples = 32;

/// Paints rgb = (direction + 1) / 2, depth = origin x + the network's first parameter, opacity = 1;
/// counts the calls.
class DirectionBackend final : public PaintBackend {
 public:
  DirectionBackend() : PaintBackend(nullptr) {}

  void sample_stratified(int n_rays, const kernels::StratifiedSampling& how, std::span<float> t,
                         std::span<float> dt) override {
    EXPECT_FALSE(how.jitter);
    EXPECT_EQ(how.per_ray, kSamples);
    EXPECT_EQ(how.near_m, 1.0f);
    EXPECT_EQ(how.far_m, 10.0f);
    EXPECT_EQ(t.size(), std::size_t(n_rays) * kSamples);
    EXPECT_EQ(dt.size(), t.size());
    tiles.push_back(n_rays);
  }
  void sample_hierarchical(const kernels::Samples& coarse, std::span<const float> weights,
                           int extra, bool jitter, std::uint64_t, std::span<float> t,
                           std::span<float> dt) override {
    EXPECT_FALSE(jitter);
    EXPECT_EQ(coarse.per_ray, kSamples);
    EXPECT_EQ(extra, kFineSamples);
    EXPECT_EQ(weights.size(), coarse.t.size());
    for (const float w : weights) ASSERT_EQ(w, 0.25f) << "not the weights of the coarse network";
    EXPECT_EQ(t.size(), coarse.t.size() / kSamples * (kSamples + kFineSamples));
    EXPECT_EQ(dt.size(), t.size());
    ++hierarchical;
  }
  void render_rays(const kernels::NerfField& field, const kernels::Rays& rays,
                   const kernels::Samples& samples, const kernels::CompositeOut& out) override {
    EXPECT_EQ(rays.origin.size(), 3 * std::size_t(rays.n));
    EXPECT_EQ(samples.t.size(), std::size_t(rays.n) * samples.per_ray);
    for (int i = 0; i < rays.n; ++i) {
      for (int c = 0; c < 3; ++c)
        out.rgb[c * rays.n + i] = 0.5f * (rays.direction[c * rays.n + i] + 1);
      out.depth[i] = rays.origin[i] + field.parameters[0];
      out.opacity[i] = 1;
    }
    for (float& w : out.weights) w = 0.25f;
  }

  std::vector<int> tiles;
  int hierarchical = 0;
};

std::unique_ptr<NerfModel> nerf_model(int fine_samples) {
  auto made = std::make_unique<NerfModel>();
  NerfModel& model = *made;
  model.config.width = 32;
  model.samples = kSamples;
  model.fine_samples = fine_samples;
  model.near_m = 1;
  model.far_m = 10;
  const std::size_t size = nerf_parameter_count(model.config);
  model.parameters = Buffer<float>(model.size());
  model.parameters[0] = 100;                           // coarse
  if (fine_samples > 0) model.parameters[size] = 200;  // fine
  return made;
}

/// Every pixel has its own direction except in column 7, which has none.
RayTable make_table(int width, int height) {
  RayTable table;
  table.width = width;
  table.height = height;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (x == 7) continue;
      table.pixel.push_back(y * width + x);
      const double angle = 2.0 * x / width, z = 0.9 * y / height;
      const double level = std::sqrt(1 - z * z);
      for (const double v : {level * std::cos(angle), level * std::sin(angle), z})
        table.direction.push_back(static_cast<float>(v));
    }
  return table;
}

Rigid3d tilted() {
  Rigid3d world_from_camera = Rigid3d::Identity();
  world_from_camera.translate(Eigen::Vector3d(3.5, -2, 1));
  world_from_camera.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized()));
  return world_from_camera;
}

// A float direction rotated in double or float and mapped to [0, 1]: three products and two sums of
// values below 1, each within half an ulp of 1 (6e-8).
constexpr float kColourTolerance = 6 * 6e-8f;

void expect_directions(const RenderedImage& image, const RayTable& table,
                       const Rigid3d& world_from_camera, float depth) {
  std::size_t k = 0;
  for (std::size_t pixel = 0; pixel < image.valid.size(); ++pixel) {
    const bool valid = k < table.pixel.size() && table.pixel[k] == pixel;
    ASSERT_EQ(image.valid[pixel], valid ? 1 : 0) << "pixel " << pixel;
    Eigen::Vector3d colour = Eigen::Vector3d::Zero();
    if (valid) {
      const Eigen::Vector3d direction(table.direction[3 * k], table.direction[3 * k + 1],
                                      table.direction[3 * k + 2]);
      colour = (0.5 * (world_from_camera.linear() * direction)).array() + 0.5;
      ++k;
    }
    for (int c = 0; c < 3; ++c)
      ASSERT_NEAR(image.rgb[3 * pixel + c], colour[c], kColourTolerance) << "pixel " << pixel;
    ASSERT_EQ(image.depth[pixel], valid ? depth : 0.0f) << "pixel " << pixel;
    ASSERT_EQ(image.opacity[pixel], valid ? 1.0f : 0.0f) << "pixel " << pixel;
  }
  EXPECT_EQ(k, table.pixel.size());
}

TEST(Renderer, TracesSingleRaysAcrossTiles) {
  constexpr int kRays = 17000;
  std::vector<float> origin(3 * kRays), direction(3 * kRays);
  for (int i = 0; i < kRays; ++i) {
    origin[i] = static_cast<float>(i);
    direction[2 * kRays + i] = 1;
  }
  DirectionBackend backend;
  const RenderedRays rays = nerf_model(0)->trace(backend, {kRays, origin, direction});
  EXPECT_EQ(backend.tiles, (std::vector<int>{8192, 8192, kRays - 2 * 8192}));
  ASSERT_EQ(rays.depth.size(), std::size_t{kRays});
  for (int i = 0; i < kRays; ++i) ASSERT_EQ(rays.depth[i], static_cast<float>(i) + 100) << i;
  EXPECT_EQ(rays.opacity, std::vector<float>(kRays, 1));
}

TEST(Renderer, WritesEachRayToItsPixelAcrossTiles) {
  const RayTable table = make_table(180, 100);  // 17,900 rays: two tiles of 8192 and a smaller one
  DirectionBackend backend;
  const RenderedImage image = render_image(backend, *nerf_model(0), table, tilted());
  EXPECT_EQ(image.width, 180);
  EXPECT_EQ(image.height, 100);
  expect_directions(image, table, tilted(), 103.5f);
  EXPECT_EQ(backend.tiles, (std::vector<int>{8192, 8192, 17900 - 2 * 8192}));
  EXPECT_EQ(backend.hierarchical, 0);
}

TEST(Renderer, RendersNoEmptyTile) {
  const RayTable table = make_table(129, 64);  // 128 * 64 = 8192 rays
  DirectionBackend backend;
  expect_directions(render_image(backend, *nerf_model(0), table, tilted()), table, tilted(),
                    103.5f);
  EXPECT_EQ(backend.tiles, std::vector<int>{8192});
}

TEST(Renderer, UsesTheFineNetworkIfThereIsOne) {
  const RayTable table = make_table(30, 20);
  DirectionBackend backend;
  expect_directions(render_image(backend, *nerf_model(kFineSamples), table, tilted()), table,
                    tilted(), 203.5f);
  EXPECT_EQ(backend.hierarchical, 1);
}

TEST(Renderer, IsBlackWithoutValidPixels) {
  RayTable table;
  table.width = 4;
  table.height = 3;
  DirectionBackend backend;
  const RenderedImage image = render_image(backend, *nerf_model(0), table, Rigid3d::Identity());
  EXPECT_EQ(image.rgb, std::vector<float>(36, 0.0f));
  EXPECT_EQ(image.valid, std::vector<std::uint8_t>(12, 0));
  EXPECT_TRUE(backend.tiles.empty());
}

TEST(Renderer, RoundsAndClampsToEightBitsAndMillimetres) {
  RenderedImage image;
  image.width = 2;
  image.height = 1;
  image.rgb = {0, 1, 0.5f, -0.25f, 1.75f, 100.49f / 255};
  image.depth = {1.2346f, 70.0f};
  EXPECT_EQ(to_image8(image).rgb, (std::vector<std::uint8_t>{0, 255, 128, 0, 255, 100}));
  EXPECT_EQ(depth_mm(image), (std::vector<std::uint16_t>{1235, 65535}));
}

}  // namespace
}  // namespace redrive
