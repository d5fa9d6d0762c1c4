// SPDX-License-Identifier: Apache-2.0
// Batches gathered by every backend against those gathered by the samplers: the same bits.
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "candidates.h"
#include "redrive/camera/example_cameras_testing.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/rays/ray_table.h"

namespace redrive::kernels::conformance {
namespace {

class GatherStages : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, GatherStages, testing::ValuesIn(candidates()), name_of);

Rigid3d some_pose(std::uint64_t i) {
  const Eigen::Vector3d axis(uniform(500, 7 * i), uniform(500, 7 * i + 1), 1.5);
  Rigid3d pose(Eigen::AngleAxisd(3 * uniform(500, 7 * i + 2), axis.normalized()));
  for (int k = 0; k < 3; ++k) pose.translation()[k] = 20 * uniform(500, 7 * i + 3 + k);
  return pose;
}

/// All camera models, every other camera with a rolling shutter, at three frames, one of them held
/// out. Some images have masks. With a background, images have alpha, which is 0 in some pixels.
struct ExampleScene {
  Scene scene;
  std::vector<Image8> images;

  ExampleScene(Background background, bool random_background) {
    constexpr int kFrames = 3;
    scene.background = background;
    scene.random_background = random_background;
    for (int f = 0; f < kFrames; ++f)
      scene.frames.push_back({f, f * 100'000'000, Rigid3d::Identity()});
    for (const ExampleCamera& example : example_cameras()) {
      const Camera camera = example.camera.downscaled(5);
      scene.rig.push_back({example.name, camera, camera, some_pose(scene.rig.size())});
      for (int f = 0; f < kFrames; ++f) {
        scene.views.push_back({static_cast<int>(scene.rig.size()) - 1, f, "", f == 1});
        images.push_back(f == 1 ? Image8{} : image(camera, images.size()));
      }
    }
    move(0);
  }

  void move(std::uint64_t to) {
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      View& view = scene.views[v];
      view.world_from_body = some_pose(1000 * to + 10 * v);
      view.by_row.clear();
      for (int key = 0; view.camera % 2 == 1 && key < 4; ++key) {
        view.by_row.push_back(view.world_from_body);
        view.by_row.back().rotate(
            Eigen::AngleAxisd(0.1 * key, Eigen::Vector3d(1, 2, 3).normalized()));
        view.by_row.back().translation().x() += 0.3 * key;
      }
    }
  }

 private:
  Image8 image(const Camera& camera, std::uint64_t number) const {
    const std::size_t pixels = static_cast<std::size_t>(camera.width) * camera.height;
    Image8 image{camera.width, camera.height, std::vector<std::uint8_t>(3 * pixels)};
    for (std::size_t i = 0; i < image.rgb.size(); ++i) image.rgb[i] = random_bits(number, i) & 255;
    if (number % 3 == 1) {
      image.used.resize(pixels);
      for (std::size_t i = 0; i < pixels; ++i) image.used[i] = i / 40 % 3 == 0 ? 0 : 255;
    }
    if (scene.background != Background::kNone) {
      image.alpha.resize(pixels);
      for (std::size_t i = 0; i < pixels; ++i)
        image.alpha[i] = i % 7 < 3 ? 0 : random_bits(number + 1000, i) & 255;
    }
    return image;
  }
};

void expect_same(const RayBatch& got, const RayBatch& expected) {
  ASSERT_EQ(got.n, expected.n);
  EXPECT_EQ(got.error_map_rays, expected.error_map_rays);
  EXPECT_EQ(got.view, expected.view);
  EXPECT_EQ(got.cell, expected.cell);
  EXPECT_TRUE(bit_equal(got.origin, expected.origin));
  EXPECT_TRUE(bit_equal(got.target, expected.target));
  EXPECT_TRUE(bit_equal(got.background, expected.background));
  EXPECT_TRUE(bit_equal(got.pixel_angle, expected.pixel_angle));
  ASSERT_EQ(got.exposure.size(), expected.exposure.size());
  for (std::size_t i = 0; i < expected.exposure.size(); ++i) {
    EXPECT_EQ(got.exposure[i].camera, expected.exposure[i].camera);
    EXPECT_EQ(got.exposure[i].t_s, expected.exposure[i].t_s);
  }
  EXPECT_TRUE(bit_equal(got.direction, expected.direction));
  EXPECT_TRUE(bit_equal(got.weight, expected.weight));
}

TEST_P(GatherStages, PixelsMatchTheHost) {
  const auto backend = make();
  for (const auto& [background, random_background] : {std::pair{Background::kNone, false},
                                                      {Background::kWhite, false},
                                                      {Background::kWhite, true}}) {
    ExampleScene example(background, random_background);
    PixelSampler sampler(example.scene, example.images, 5);
    const std::vector<float> errors = random_floats(sampler.cells().size(), 501, 0, 1);
    std::vector<float> before;
    for (const bool moved : {false, true}) {
      if (moved) {
        example.move(1);
        sampler.update_poses();
      }
      for (const std::uint64_t first :
           {std::uint64_t{0}, sampler.pixels() - 100, 3 * sampler.pixels() + 777})
        for (const int error_map_rays : {0, 150}) {
          SCOPED_TRACE(testing::Message()
                       << "background " << static_cast<int>(background) << ", random "
                       << random_background << ", pixels from " << first << ", " << error_map_rays
                       << " by the error map, moved " << moved);
          RayBatch got, expected;
          sampler.gather(first, 400, &expected, {error_map_rays, errors});
          const PixelDraw draw = sampler.draw(first, 400, error_map_rays);
          EXPECT_EQ(draw.epoch_rays, first == sampler.pixels() - 100 ? 100 : 400);
          const GatheredRays spans = sampler.resize_batch(draw, &got);
          backend->gather_pixels(sampler.source(), draw, errors, spans);
          expect_same(got, expected);
          if (first > 0 || error_map_rays > 0) continue;
          EXPECT_NE(got.origin, before);
          before = got.origin;
        }
    }
  }
}

TEST_P(GatherStages, LidarReturnsMatchTheHost) {
  constexpr std::size_t kReturns = 5000, kFrames = 6;
  const auto backend = make();
  LidarReturns returns;
  returns.n = kReturns;
  returns.origin = random_floats(3 * kReturns, 505, -100, 100);
  returns.direction = random_floats(3 * kReturns, 506, -1, 1);
  returns.range_m = random_floats(kReturns, 507, 1, 80);
  for (std::size_t i = 0; i < kReturns; ++i)  // between frames, outside them, and at their times
    returns.t_ns.push_back(static_cast<std::int64_t>(random_bits(508, i) % 800) * 1'000'000 -
                           100'000'000);
  std::vector<FramePose> recorded;
  for (std::size_t f = 0; f < kFrames; ++f) {
    recorded.push_back({static_cast<std::int64_t>(f), static_cast<std::int64_t>(f) * 100'000'000,
                        some_pose(2000)});
    recorded.back().global_from_body.translation() +=
        Eigen::Vector3d(4e6, 1e6 + 2.0 * static_cast<double>(f), 5e6);
  }
  for (const bool refines : {false, true}) {
    LidarSampler sampler(returns, 5);
    std::vector<float> before;
    for (int moved = 0; moved <= refines; ++moved) {
      std::vector<FramePose> now = recorded;
      for (FramePose& frame : now) {
        const auto f = static_cast<double>(frame.id);
        frame.global_from_body.translate(Eigen::Vector3d(0.1 * moved, 0, 0.01 * f));
        frame.global_from_body.rotate(Eigen::AngleAxisd(0.02 * f, Eigen::Vector3d::UnitY()));
      }
      if (refines) sampler.update_poses(recorded[0].global_from_body, recorded, now);
      for (const std::int64_t step : {0, 40})
        for (const int n : {1, 700}) {
          SCOPED_TRACE(testing::Message() << n << " rays of step " << step << ", refines "
                                          << refines << ", " << moved);
          RayBatch got, expected;
          sampler.gather(step, n, &expected);
          const GatheredReturns spans = sampler.resize_batch(n, &got);
          backend->gather_returns(sampler.source(), sampler.draw(step, n), spans);
          EXPECT_EQ(got.n, n);
          EXPECT_TRUE(bit_equal(got.range_m, expected.range_m));
          EXPECT_TRUE(bit_equal(got.pixel_angle, expected.pixel_angle));
          EXPECT_TRUE(bit_equal(got.origin, expected.origin));
          EXPECT_TRUE(bit_equal(got.direction, expected.direction));
          if (step > 0 || n == 1) continue;
          EXPECT_NE(got.origin, before);
          before = got.origin;
        }
    }
  }
}

TEST_P(GatherStages, UpdatesErrorMapInOrder) {
  const auto backend = make();
  for (const std::uint32_t n : {1u, 100u, 3000u})
    for (const std::uint32_t all : {1u, 50u, 10'000u}) {  // cells with many rays and with few
      SCOPED_TRACE(testing::Message() << n << " rays in " << all << " cells");
      std::vector<std::uint32_t> cells(n);
      for (std::uint32_t i = 0; i < n; ++i) cells[i] = random_bits(502, i) % all;
      const std::vector<float> squares = random_floats(n, 503, 0, 1.2);  // some above kInitialError
      std::vector<float> errors = random_floats(all, 504, 0, 1), expected;
      for (std::size_t cell = 0; cell < all; cell += 3) errors[cell] = kInitialError;
      expected = errors;
      redrive::update_error_map(cells, squares, expected);
      backend->update_error_map(cells, squares, errors);
      EXPECT_TRUE(bit_equal(errors, expected));
    }
}

}  // namespace
}  // namespace redrive::kernels::conformance
