// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/ray_table.h"

#include <cmath>
#include <map>
#include <numeric>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

class RaysTest : public testing::Test {
 protected:
  explicit RaysTest(SceneOptions options = {})
      : scene_(make_scene(make_test_recording(folder_.path), options)) {
    ThreadPool pool(1);
    images_ = load_views(scene_, pool);
  }
  TemporaryFolder folder_;
  Scene scene_;
  std::vector<Image8> images_;
};

Eigen::Vector3d column(const std::vector<float>& soa, int n, int i) {
  return {soa[i], soa[n + i], soa[2 * n + i]};
}

std::vector<std::uint32_t> entries_from(std::size_t first, std::size_t count) {
  std::vector<std::uint32_t> entries(count);
  std::iota(entries.begin(), entries.end(), static_cast<std::uint32_t>(first));
  return entries;
}

TEST_F(RaysTest, TableHoldsEveryPixelOfTheValidRegion) {
  for (const RigCamera& rig : scene_.rig) {
    SCOPED_TRACE(rig.name);
    const RayTable table = make_ray_table(rig.camera);
    std::size_t k = 0;
    for (int y = 0; y < table.height; ++y)
      for (int x = 0; x < table.width; ++x) {
        const auto direction = rig.camera.unproject({x, y});
        if (!direction) continue;
        ASSERT_LT(k, table.pixel.size());
        EXPECT_EQ(table.pixel[k], static_cast<std::uint32_t>(y * table.width + x));
        const Eigen::Vector3d stored(table.direction[3 * k], table.direction[3 * k + 1],
                                     table.direction[3 * k + 2]);
        EXPECT_LT((stored - *direction).norm(), 1e-7);
        ++k;
      }
    EXPECT_EQ(k, table.pixel.size());
    const std::size_t all = std::size_t(table.width) * table.height;
    EXPECT_EQ(k < all, rig.name == "FISHEYE");  // its corners lie beyond its fold
  }
}

TEST_F(RaysTest, TableDoesNotDependOnTheNumberOfThreads) {
  for (const RigCamera& rig : scene_.rig) {
    ThreadPool pool(3);
    const RayTable one = make_ray_table(rig.camera), many = make_ray_table(rig.camera, pool);
    EXPECT_EQ(one.pixel, many.pixel);
    EXPECT_EQ(one.direction, many.direction);
  }
}

TEST_F(RaysTest, RaysOfAViewHitTheProjectedPoints) {
  const View& view = scene_.views[9];  // FRONT at frame 3
  const Rigid3d world_from_camera = scene_.world_from_camera(view);
  const Camera& camera = scene_.rig[view.camera].camera;
  const RayTable table = make_ray_table(camera);
  RayBatch rays;
  view_rays(table, world_from_camera, entries_from(24, 48), &rays);
  ASSERT_EQ(rays.n, 48);
  ASSERT_EQ(rays.origin.size(), 144u);
  EXPECT_TRUE(rays.target.empty());
  for (int i = 0; i < rays.n; ++i) {
    const Eigen::Vector3d origin = column(rays.origin, 48, i),
                          direction = column(rays.direction, 48, i);
    EXPECT_NEAR(direction.norm(), 1, 1e-6);
    const auto pixel = camera.project(world_from_camera.inverse() * (origin + 5 * direction));
    ASSERT_TRUE(pixel);
    // Float steps of 5e-7 m and 6e-8 at 5 m distance, focal length 22: 1e-5 px.
    EXPECT_LT((*pixel - Eigen::Vector2d(i % 24, 1 + i / 24)).norm(), 1e-5) << i;
  }
}

TEST_F(RaysTest, RollingShutterRowsStartAtTheirExposurePose) {
  const RayTable table = make_ray_table(scene_.rig[1].camera);
  const auto at = [](double x) { return Rigid3d(Eigen::Translation3d(x, 0, 0)); };
  const ShutterPoses poses({at(0), at(16)});  // 16 rows
  RayBatch rays;
  view_rays(table, poses, entries_from(0, table.pixel.size()), &rays);
  ASSERT_EQ(rays.n, 24 * 16);
  for (int i = 0; i < rays.n; ++i) {
    EXPECT_EQ(rays.origin[i], static_cast<float>(i / 24 + 0.5)) << i;
    EXPECT_EQ(rays.direction[i], table.direction[3 * i]);
  }
}

TEST_F(RaysTest, OrItsColumns) {
  const RayTable table = make_ray_table(scene_.rig[1].camera);
  const auto at = [](double x) { return Rigid3d(Eigen::Translation3d(x, 0, 0)); };
  const ShutterPoses poses({at(0), at(24)}, /*by_column=*/true);  // 24 columns
  RayBatch rays;
  view_rays(table, poses, entries_from(0, table.pixel.size()), &rays);
  ASSERT_EQ(rays.n, 24 * 16);
  for (int i = 0; i < rays.n; ++i) EXPECT_EQ(rays.origin[i], static_cast<float>(i % 24 + 0.5)) << i;
}

class SamplerTest : public RaysTest {
 protected:
  SamplerTest() : RaysTest(holdout()) {}
  static SceneOptions holdout() {
    SceneOptions options;
    options.holdout_every = 3;
    return options;
  }
  std::size_t training_pixels() const {
    std::size_t pixels = 0;
    for (const View& view : scene_.views)
      if (!view.held_out) pixels += make_ray_table(scene_.rig[view.camera].camera).pixel.size();
    return pixels;
  }
};

using Ray = std::array<float, 9>;

Ray ray_of(const RayBatch& batch, int i) {
  Ray ray;
  for (int d = 0; d < 3; ++d) {
    ray[d] = batch.origin[d * batch.n + i];
    ray[3 + d] = batch.direction[d * batch.n + i];
    ray[6 + d] = batch.target[d * batch.n + i];
  }
  return ray;
}

/// Rays of several epochs in batches of 100; the first batch is split into 37 and 63.
std::map<Ray, int> count_rays(const PixelSampler& sampler, std::uint64_t first_epoch,
                              std::uint64_t epochs) {
  std::map<Ray, int> counts;
  RayBatch batch;
  const std::uint64_t begin = first_epoch * sampler.pixels(),
                      end = begin + epochs * sampler.pixels();
  int rays = 37;
  for (std::uint64_t drawn = begin; drawn < end; drawn += batch.n) {
    sampler.gather(drawn, rays, &batch);
    for (int i = 0; i < batch.n; ++i) ++counts[ray_of(batch, i)];
    rays = rays == 37 ? 63 : 100;
  }
  return counts;
}

// Each epoch visits every training pixel exactly once, with its own ray and colour, and no pixel of
// a held-out view.
TEST_F(SamplerTest, AnEpochVisitsEveryTrainingPixelOnce) {
  const PixelSampler sampler(scene_, images_, 5);
  ASSERT_EQ(sampler.pixels(), training_pixels());
  std::map<Ray, int> expected;
  for (std::size_t v = 0; v < scene_.views.size(); ++v) {
    const View& view = scene_.views[v];
    if (view.held_out) continue;
    const RayTable table = make_ray_table(scene_.rig[view.camera].camera);
    RayBatch rays;
    view_rays(table, scene_.world_from_camera(view), entries_from(0, table.pixel.size()), &rays);
    for (int i = 0; i < rays.n; ++i) {
      Ray ray;
      const int x = table.pixel[i] % table.width, y = table.pixel[i] / table.width;
      const auto colour = test_colour(view.camera, view.frame, x, y);
      for (int d = 0; d < 3; ++d) {
        ray[d] = rays.origin[d * rays.n + i];
        ray[3 + d] = rays.direction[d * rays.n + i];
        ray[6 + d] = colour[d] / 255.0f;
      }
      ++expected[ray];
    }
  }
  ASSERT_NE(sampler.pixels() % 100, 0u);
  EXPECT_EQ(sampler.steps_per_epoch(100), std::int64_t(sampler.pixels() / 100 + 1));
  for (std::uint64_t epoch = 0; epoch < 2; ++epoch)
    EXPECT_EQ(count_rays(sampler, epoch, 1), expected) << epoch;
}

// Two training views have masks; one mask covers everything.
TEST_F(SamplerTest, MaskedPixelsAreNotDrawn) {
  const PixelSampler whole(scene_, images_, 5);
  std::size_t expected = whole.pixels();
  std::vector<std::size_t> training;
  for (std::size_t v = 0; v < scene_.views.size(); ++v)
    if (!scene_.views[v].held_out) training.push_back(v);
  for (const std::size_t v : {training[1], training[6]}) {
    const RayTable table = make_ray_table(scene_.rig[scene_.views[v].camera].camera);
    images_[v].used.assign(std::size_t(table.width) * table.height, 0);
    for (const std::uint32_t pixel : table.pixel) {
      if (v == training[6] && pixel % 24 >= 10) {
        images_[v].used[pixel] = 255;
      } else {
        --expected;
      }
    }
  }
  const PixelSampler sampler(scene_, images_, 5);
  ASSERT_EQ(sampler.pixels(), expected);
  const auto counts = count_rays(sampler, 0, 1);
  const View& masked = scene_.views[training[6]];
  const Eigen::Vector3d origin = scene_.world_from_camera(masked).translation();
  const Eigen::Vector3d nowhere = scene_.world_from_camera(scene_.views[training[1]]).translation();
  std::size_t rays = 0;
  for (const auto& [ray, count] : counts) {
    EXPECT_EQ(count, 1);
    const Eigen::Vector3d at(ray[0], ray[1], ray[2]);
    EXPECT_GT((at - nowhere).norm(), 1e-3);
    if ((at - origin).norm() > 1e-3) continue;
    ++rays;
    EXPECT_GE(std::lround(ray[6] * 255), test_colour(masked.camera, masked.frame, 10, 0)[0])
        << "column 10 or right of it";
  }
  EXPECT_EQ(rays, 14u * 16) << "columns 10 to 23 of the front camera";
  for (Image8& image : images_) image.used.assign(image.rgb.size() / 3, 0);
  EXPECT_THROW(PixelSampler(scene_, images_, 5), InputError);
}

TEST_F(SamplerTest, TransparentPixelsAreDrawnEveryFourthEpoch) {
  // The left ten columns are transparent in every image but the first. A mask leaves half of each
  // part of the second image.
  const PixelSampler whole(scene_, images_, 5);
  std::vector<std::size_t> training;
  for (std::size_t v = 0; v < scene_.views.size(); ++v)
    if (!scene_.views[v].held_out) training.push_back(v);
  std::size_t solid = 0, empty_an_epoch = 0, empty = 0;
  for (const std::size_t v : training) {
    const RayTable table = make_ray_table(scene_.rig[scene_.views[v].camera].camera);
    Image8& image = images_[v];
    if (v != training[0]) image.alpha.assign(image.rgb.size() / 3, 255);
    if (v == training[1]) image.used.assign(image.rgb.size() / 3, 255);
    std::size_t empty_here = 0;
    for (const std::uint32_t pixel : table.pixel) {
      if (v == training[1] && pixel / table.width % 2 == 0) {
        image.used[pixel] = 0;
      } else if (v != training[0] && static_cast<int>(pixel) % table.width < 10) {
        image.alpha[pixel] = 0;
        ++empty_here;
      } else {
        ++solid;
      }
    }
    empty_an_epoch += (empty_here + 3) / 4;
    empty += empty_here;
  }
  const PixelSampler sampler(scene_, images_, 5);
  ASSERT_EQ(sampler.pixels(), solid + empty_an_epoch);
  std::uint64_t counted = 0;
  for (const std::size_t v : training)
    counted += epoch_pixels(make_ray_table(scene_.rig[scene_.views[v].camera].camera), images_[v]);
  EXPECT_EQ(counted, sampler.pixels());
  EXPECT_EQ(PixelSampler(scene_, counted, 5).pixels(), counted);
  EXPECT_THROW(PixelSampler(scene_, std::uint64_t{0}, 5), InputError);
  EXPECT_EQ(count_rays(sampler, 0, 1).size(), sampler.pixels())
      << "each once, and another fourth of the transparent ones";
  const auto four_epochs = count_rays(sampler, 0, 4);
  EXPECT_EQ(four_epochs.size(), solid + empty);
  std::size_t often = 0;
  for (const auto& [ray, count] : four_epochs) often += count == 4;
  EXPECT_NEAR(often, solid, training.size()) << "and an image's last transparent one";
}

TEST_F(SamplerTest, BatchesCarryTheirBackground) {
  RayBatch plain, batch;
  PixelSampler(scene_, images_, 5).gather(3 * 64, 64, &plain);
  EXPECT_TRUE(plain.background.empty());
  const auto expect_all = [&](Background background, float value) {
    scene_.background = background;
    PixelSampler(scene_, images_, 5).gather(3 * 64, 64, &batch);
    EXPECT_EQ(batch.background, std::vector<float>(3 * 64, value));
    EXPECT_EQ(batch.target, plain.target) << "composited when it was loaded";
  };
  expect_all(Background::kWhite, 1);
  expect_all(Background::kBlack, 0);

  scene_.background = Background::kWhite;
  scene_.random_background = true;
  for (Image8& image : images_) image.alpha.assign(image.rgb.size() / 3, 204);  // 0.8
  const PixelSampler sampler(scene_, images_, 5);
  sampler.gather(3 * 64, 64, &batch);
  ASSERT_EQ(batch.background.size(), 3u * 64);
  double sum = 0;
  for (std::size_t i = 0; i < batch.target.size(); ++i) {
    EXPECT_NEAR(batch.target[i], plain.target[i] + 0.2 * (batch.background[i] - 1), 1e-6);
    EXPECT_TRUE(batch.background[i] >= 0 && batch.background[i] < 1);
    sum += batch.background[i];
  }
  EXPECT_NEAR(sum / 192, 0.5,
              5 * std::sqrt(1.0 / 12 / 192));  // five standard deviations of the mean
  const std::vector<float> before = batch.background;
  sampler.gather(4 * 64, 64, &batch);
  EXPECT_NE(batch.background, before);
  sampler.gather(3 * 64, 64, &batch);
  EXPECT_EQ(batch.background, before) << "a function of the seed and the index";
}

TEST_F(SamplerTest, TheLastBatchOfAnEpochIsSmaller) {
  const PixelSampler sampler(scene_, images_, 5);
  RayBatch batch;
  sampler.gather(sampler.pixels() - 10, 64, &batch);
  EXPECT_EQ(batch.n, 10);
  sampler.gather(sampler.pixels(), 64, &batch);
  EXPECT_EQ(batch.n, 64);
}

TEST_F(SamplerTest, ABatchIsAFunctionOfSeedAndPosition) {
  const PixelSampler a(scene_, images_, 5), b(scene_, images_, 5), other(scene_, images_, 6);
  RayBatch one, two;
  b.gather(150, 50, &two);  // in another order
  b.gather(2000, 50, &two);
  a.gather(2000, 50, &one);
  EXPECT_EQ(one.origin, two.origin);
  EXPECT_EQ(one.direction, two.direction);
  EXPECT_EQ(one.target, two.target);
  other.gather(2000, 50, &two);
  EXPECT_NE(one.direction, two.direction);
  // The next epoch is shuffled anew.
  a.gather(2000 + a.pixels(), 50, &two);
  EXPECT_NE(one.direction, two.direction);
}

// Half of an image is masked, half of another is transparent, cameras have invalid pixels, and
// frames are held out.
TEST_F(SamplerTest, ErrorMapRaysFollowSamplingWeightsAndErrors) {
  std::vector<std::size_t> training;
  for (std::size_t v = 0; v < scene_.views.size(); ++v)
    if (!scene_.views[v].held_out) training.push_back(v);
  Image8 &masked = images_[training[0]], &transparent = images_[training[1]];
  masked.used.assign(masked.rgb.size() / 3, 255);
  for (std::size_t pixel = 0; pixel < masked.used.size(); ++pixel)
    if (static_cast<int>(pixel) % masked.width < 10) masked.used[pixel] = 0;
  transparent.alpha.assign(transparent.rgb.size() / 3, 255);
  for (std::size_t pixel = 0; pixel < transparent.alpha.size(); ++pixel)
    if (static_cast<int>(pixel) % transparent.width < 10) transparent.alpha[pixel] = 0;
  const PixelSampler sampler(scene_, images_, 5);
  const auto allowed = count_rays(
      sampler, 0, 4);  // opaque pixels four times, transparent ones once, except the last
  ASSERT_GT(allowed.size(), sampler.pixels());

  constexpr int kBatches = 100, kByError = 2000;
  const auto draw = [&](const std::vector<float>& errors) {
    std::map<Ray, int> counts;
    RayBatch batch;
    for (int i = 0; i < kBatches; ++i) {
      sampler.gather(3 * i, 3, &batch, {kByError, errors});
      EXPECT_EQ(batch.n, 3 + kByError);
      EXPECT_EQ(batch.error_map_rays, kByError);
      EXPECT_EQ(batch.cell.size(), 3u + kByError);
      for (int k = 3; k < batch.n; ++k) ++counts[ray_of(batch, k)];
    }
    return counts;
  };
  const auto rate = [&](const std::map<Ray, int>& counts, const auto& wanted) {
    double sum = 0;
    for (const auto& [ray, count] : counts) {
      EXPECT_TRUE(allowed.contains(ray));
      if (wanted(ray)) sum += count;
    }
    return sum / (kBatches * kByError);
  };
  const auto at = [&](std::size_t v) {
    const Eigen::Vector3f origin =
        scene_.world_from_camera(scene_.views[v]).translation().cast<float>();
    return [=](const Ray& ray) {
      return ray[0] == origin.x() && ray[1] == origin.y() && ray[2] == origin.z();
    };
  };
  // Images of at most 32 pixels across have one cell per pixel. With equal errors a pixel is drawn
  // in proportion to its weight.
  std::vector<float> errors(sampler.cells().size(), 0.01f);
  const auto even = draw(errors);
  double shares = 0;  // in quarters
  for (const auto& [ray, count] : allowed) shares += count;
  for (const std::size_t v : training) {
    double of_view = 0;
    for (const auto& [ray, count] : allowed)
      if (at(v)(ray)) of_view += count;
    const double expected = of_view / shares;
    EXPECT_NEAR(rate(even, at(v)), expected,
                5 * std::sqrt(expected / (kBatches * kByError)) + 2 / shares)
        << v;
  }
  // An image whose error is nine times the others' is drawn more often.
  const int image = 3;
  std::size_t cells = 0;
  for (std::size_t cell = 0; cell < errors.size(); ++cell)
    if (sampler.cells().rect(cell).image == image) {
      errors[cell] *= 9;
      ++cells;
    }
  ASSERT_GT(cells, 0u);
  const double before = rate(even, at(training[image])),
               after = rate(draw(errors), at(training[image]));
  EXPECT_GT(after / before, 3);
  EXPECT_LT(after / before, kCellCandidates);
}

TEST_F(SamplerTest, ErrorMapRaysFollowTheUniformOnesWithTheirCells) {
  const PixelSampler sampler(scene_, images_, 5);
  std::vector<float> errors(sampler.cells().size(), 0.01f);
  RayBatch plain, batch, again, elsewhere;
  sampler.gather(320, 64, &plain);
  EXPECT_TRUE(plain.cell.empty());
  EXPECT_EQ(plain.error_map_rays, 0);
  sampler.gather(320, 64, &batch, {32, errors});
  ASSERT_EQ(batch.n, 96);
  for (int i = 0; i < 64; ++i) EXPECT_EQ(ray_of(batch, i), ray_of(plain, i));
  PixelSampler(scene_, images_, 5).gather(320, 64, &again, {32, errors});
  EXPECT_EQ(again.direction, batch.direction);
  EXPECT_EQ(again.cell, batch.cell);
  sampler.gather(384, 64, &elsewhere, {32, errors});
  int same = 0;
  for (int i = 64; i < 96; ++i) same += ray_of(batch, i) == ray_of(elsewhere, i);
  EXPECT_LT(same, 8);
  for (int i = 0; i < 96; ++i) {  // the colour identifies the pixel; each cell has one pixel
    const Ray ray = ray_of(batch, i);
    const CellRect rect = sampler.cells().rect(batch.cell[i]);
    EXPECT_EQ(std::lround(ray[6] * 255), 5 * rect.x);
    EXPECT_EQ(std::lround(ray[7] * 255), 7 * rect.y);
    EXPECT_EQ(rect.width * rect.height, 1);
  }
  EXPECT_TRUE(plain.weight.empty());
  for (const float weight : batch.weight)
    EXPECT_NEAR(weight, 1, 1e-5) << "the errors are all the same";
  errors[batch.cell[3]] = 1;
  sampler.gather(320, 64, &batch, {32, errors});
  EXPECT_NEAR(batch.weight[3], 1 / (2 / 3.0 + 8 / 3.0), 0.1)
      << "drawn about 8 times as often by a third of the rays";
  EXPECT_EQ(batch.weight.size(), 96u);
  errors[batch.cell[3]] = 0.01f;
  sampler.gather(sampler.pixels() - 5, 64, &batch, {32, errors});
  EXPECT_EQ(batch.n, 5 + 32) << "the end of an epoch";
}

// A batch of 400 contains pixels of both cameras and all training frames in proportion to their
// numbers.
TEST_F(SamplerTest, BatchesMixViews) {
  const PixelSampler sampler(scene_, images_, 5);
  RayBatch batch;
  sampler.gather(0, 400, &batch);
  std::map<std::array<float, 3>, int> by_origin;
  for (int i = 0; i < batch.n; ++i)
    ++by_origin[{batch.origin[i], batch.origin[400 + i], batch.origin[800 + i]}];
  ASSERT_EQ(by_origin.size(), 8u);  // two cameras, four frames
  // Each view holds at least 1/12 of the pixels: 33 of 400 expected, standard deviation 5.5; six of
  // them below is 0.
  for (const auto& [origin, count] : by_origin) EXPECT_GT(count, 5);
}

}  // namespace
}  // namespace redrive
