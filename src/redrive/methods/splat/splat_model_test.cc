// SPDX-License-Identifier: Apache-2.0
// Steps of method splat on images of known Gaussians.
#include "redrive/methods/splat/splat_model.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>

#include "redrive/methods/splat/image_windows.h"
#include "redrive/methods/splat/known_splats_testing.h"
#include "redrive/scene/lidar/lidar_testing.h"

namespace redrive::known_splats {
namespace {

TEST(SplatModel, FindsAKnownSceneAgainInAllCameras) {
  const KnownScene known;
  const auto backend = fast_backend();
  Training training;
  training.steps = 300;
  training.model.opacity_weight = 0;  // the background is seen between the Gaussians
  training.begin(disturbed(known_gaussians(120), 0.06f));
  const double before = known.psnr_db(*backend, training.model);
  training.run(*backend, known.data());
  const double after = known.psnr_db(*backend, training.model);
  EXPECT_LT(before, 24);
  EXPECT_GT(after, 40) << "from " << before;
  EXPECT_EQ(training.model.gaussians, 120);
}

TEST(SplatModel, TheReferenceTakesTheSameSteps) {
  const KnownScene known(40);
  const auto fast = fast_backend(), ref = kernels::make_ref_backend();
  Training a, b;
  a.steps = b.steps = 4;
  a.begin(disturbed(known_gaussians(40), 0.05f));
  b.begin(disturbed(known_gaussians(40), 0.05f));
  for (std::int64_t step = 0; step < 10; ++step) {  // all images, so a camera of each kind
    StepRequest request = a.request();
    request.step = step;
    a.gradients(*fast, known.data(), request);
    b.gradients(*ref, known.data(), request);
    EXPECT_NEAR(a.loss(), b.loss(), 1e-4 * b.loss());
    EXPECT_NEAR(a.buffers.workspace.sums().opacity, b.buffers.workspace.sums().opacity, 2e-3);
    const std::span<const float> errors = a.buffers.gradients.span().last(a.model.errors()),
                                 of_ref = b.buffers.gradients.span().last(b.model.errors());
    EXPECT_GT(std::ranges::max(of_ref), 0);
    for (std::size_t i = 0; i < 40; ++i)
      EXPECT_NEAR(errors[i], of_ref[i], 0.01 * double(std::ranges::max(of_ref))) << i;
    for (int row = 0; row < kLidarRow; ++row) {
      double most = 0;
      for (std::size_t i = 0; i < 40; ++i)
        most = std::max(most, std::fabs(double(b.buffers.gradients[gaussian_slot(i, row)])));
      EXPECT_GT(most, 0);
      for (std::size_t i = 0; i < 40; ++i)
        EXPECT_NEAR(a.buffers.gradients[gaussian_slot(i, row)],
                    b.buffers.gradients[gaussian_slot(i, row)], 0.01 * most)
            << "row " << row << " of " << i << " in step " << step;
    }
  }
}

// As ranks of data-parallel training do.
TEST(SplatModel, GradientsThatAreKeptGiveTheSameGaussians) {
  const KnownScene known;
  const auto backend = fast_backend();
  Training in_step, kept;
  in_step.steps = kept.steps = 30;
  in_step.begin(disturbed(known_gaussians(40), 0.05f));
  kept.begin(disturbed(known_gaussians(40), 0.05f));
  in_step.run(*backend, known.data());
  for (; kept.step < kept.steps; ++kept.step) {
    const StepRequest request = kept.request();
    const StepOutput out = kept.gradients(*backend, known.data(), request);
    ASSERT_EQ(kept.buffers.gradients.size(), kept.model.size() + kept.model.errors());
    kept.model.update(*backend, kept.model.learning_rate({kept.step, kept.steps, request.progress}),
                      kept.step + 1, kept.buffers.gradients, &kept.adam);
    kept.model.finish_step(*backend, request, out, kept.step + 1, kept.buffers, &kept.adam);
  }
  EXPECT_TRUE(std::ranges::equal(in_step.model.parameters.span(), kept.model.parameters.span()));
  EXPECT_TRUE(std::ranges::equal(in_step.adam.packed.span(), kept.adam.packed.span()));
  EXPECT_TRUE(std::ranges::equal(in_step.adam.errors.span(), kept.adam.errors.span()));
}

TEST(SplatModel, DensifiesToItsLimitWhileItTrains) {
  const KnownScene known;
  const auto backend = fast_backend();
  Training training;
  training.steps = 300;
  training.begin(disturbed(known_gaussians(40), 0.05f));
  training.model.max_gaussians = 100;
  training.model.densify_every = 20;
  training.run(*backend, known.data());
  EXPECT_GT(training.model.gaussians, 80);
  EXPECT_LE(training.model.gaussians, 100);
  EXPECT_EQ(training.model.parameters.size(), training.model.size());
  EXPECT_EQ(training.adam.size(), training.model.size());
  EXPECT_GT(known.psnr_db(*backend, training.model), 20);
}

TEST(SplatModel, FindsTheExposuresOfImages) {
  KnownScene known;
  known.scene.metric = true;
  // One camera takes all images, each with gains of its own.
  std::vector<double> gains;
  for (std::size_t v = 0; v < known.images.size(); ++v)
    gains.push_back(std::exp(0.25 * signed_random(14, v)));
  for (std::size_t v = 0; v < known.images.size(); ++v)
    for (std::uint8_t& value : known.images[v].rgb)
      value = static_cast<std::uint8_t>(std::lround(gains[v] * value));
  const auto backend = fast_backend();
  Training training;
  training.steps = 400;
  training.model.configure(known.scene);
  ASSERT_EQ(training.model.gains.appearance.cameras, 4);
  ASSERT_EQ(training.model.gains.appearance.knots, 12);
  EXPECT_EQ(training.model.gains.shading.columns, 4) << "cells of 16 pixels of 64 x 48";
  EXPECT_EQ(training.model.gains.shading.rows, 3);
  // Exact Gaussians: what differs is the exposure.
  training.begin(known_gaussians(120));
  training.model.initial_rate = 0.01;
  training.run(*backend, known.data());
  const auto gain_of = [&](std::size_t v) {
    return colour_gains(
        training.model.gains.appearance,
        training.model.parameters.data() + gaussian_blocks(training.model.gaussians) * kBlockSize,
        known.scene.exposure(known.scene.views[v]));
  };
  double found = 0, given = 0, n = 0;  // means: a common factor is in the colours
  std::vector<double> off;
  for (std::size_t v = 0; v < known.images.size(); ++v) {
    if (known.scene.views[v].held_out) continue;
    for (const float g : gain_of(v)) {
      found += std::log(g);
      given += std::log(gains[v]);
      off.push_back(std::log(g) - std::log(gains[v]));
      ++n;
    }
  }
  for (const double one : off) EXPECT_NEAR(one - (found - given) / n, 0, 0.04);
  for (const std::size_t v : {4, 7}) {  // held out, between two images of their camera
    ASSERT_TRUE(known.scene.views[v].held_out);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(std::log(gain_of(v)[c]),
                  (std::log(gain_of(v - 4)[c]) + std::log(gain_of(v + 4)[c])) / 2, 1e-4);
  }
}

TEST(SplatModel, MaskedPixelsHaveNoEffect) {
  KnownScene a, b;
  for (std::size_t v = 0; v < a.images.size(); ++v) {
    if (a.scene.views[v].held_out) continue;
    for (KnownScene* known : {&a, &b}) {  // a corner with a whole tile, and a strip
      known->images[v].used.assign(64 * 48, 1);
      for (int y = 0; y < 48; ++y)
        for (int x = 0; x < 64; ++x)
          if ((y < 20 && x < 24) || x > 57) known->images[v].used[64 * y + x] = 0;
    }
    for (int i = 0; i < 64 * 48; ++i)
      if (!b.images[v].used[i])
        for (int c = 0; c < 3; ++c)
          b.images[v].rgb[3 * i + c] = static_cast<std::uint8_t>(7 * i + c);
  }
  const auto backend = fast_backend();
  const GaussianList start = disturbed(known_gaussians(120), 0.05f);
  Training clean, dirty, used;
  for (Training* training : {&clean, &dirty, &used}) training->begin(start);
  // Another step before must leave nothing in the masked tiles either.
  StepRequest before;
  before.step = 3;
  used.gradients(*backend, KnownScene(30, 2).data(), before);
  used.buffers.method.reset();
  for (const std::int64_t step : {0, 1, 2}) {
    StepRequest request;
    request.step = step;
    const StepOutput out = clean.gradients(*backend, a.data(), request);
    dirty.gradients(*backend, b.data(), request);
    EXPECT_EQ(out.pixels, 64 * 48 - 20 * 24 - 48 * 6);
    EXPECT_EQ(clean.loss(), dirty.loss());
    EXPECT_TRUE(std::ranges::equal(clean.buffers.gradients.span(), dirty.buffers.gradients.span()));
    EXPECT_GT(clean.loss(), 0);
  }
}

TEST(SplatModel, AStepDependsOnItsRequestAlone) {
  KnownScene known;
  for (std::size_t v = 0; v < known.images.size(); ++v)
    if (!known.scene.views[v].held_out) {  // a tile of each image is not drawn
      known.images[v].used.assign(64 * 48, 1);
      for (int y = 0; y < 16; ++y)
        std::fill_n(&known.images[v].used[64 * y + (v % 2 ? 0 : 16)], 16, 0);
    }
  const GaussianList ends = known_gaussians(120);
  std::vector<MeasuredPoint> points;
  for (std::size_t i = 0; i < ends.size(); ++i)
    points.push_back({Eigen::Vector3f(&ends.rows[i * kGaussianRows]).cast<double>()});
  known.lidar = returns_of(known.scene, points);
  const auto backend = fast_backend();
  const GaussianList start = disturbed(known_gaussians(120), 0.05f);
  Training fresh, used;
  fresh.begin(start);
  used.begin(start);
  for (std::int64_t step = 0; step < 6; ++step) {
    StepRequest request;
    request.step = step;
    used.gradients(*backend, known.data(), request);
    fresh.buffers = {};
    fresh.gradients(*backend, known.data(), request);
    EXPECT_EQ(fresh.loss(), used.loss());
    EXPECT_GT(fresh.model.loss_terms(fresh.buffers.workspace.sums())[3].value, 0) << "lidar";
    EXPECT_EQ(fresh.buffers.workspace.sums().opacity, used.buffers.workspace.sums().opacity);
    EXPECT_TRUE(std::ranges::equal(fresh.buffers.gradients.span(), used.buffers.gradients.span()));
  }
}

TEST(SplatModel, LargeImagesAreCutIntoWindowsThatCoverThem) {
  const KnownScene known(120, 2);  // 128 x 96
  const auto backend = fast_backend();
  Training training;
  training.begin(disturbed(known_gaussians(120), 0.06f));
  training.model.window_pixels = 2048;
  const std::int64_t windows = training.model.steps_per_epoch(known.data(), 1);
  EXPECT_GE(windows, 10 * 6);
  EXPECT_LE(windows, 10 * 9);
  EXPECT_EQ(training.model.steps_per_epoch(known.data(), 3), (windows + 2) / 3);
  std::int64_t pixels = 0;
  for (std::int64_t step = 0; step < windows; ++step) {
    StepRequest request;
    request.step = step;
    request.progress = 0.9;
    pixels += training.gradients(*backend, known.data(), request).epoch_pixels;
  }
  EXPECT_EQ(pixels, 10 * 128 * 96) << "each once";
  StepRequest coarse;
  coarse.progress = 0.1;
  const int of_step = training.gradients(*backend, known.data(), coarse).pixels;
  EXPECT_LE(of_step, 2048);

  training.model.densify_every = 1000;
  training.steps = 600;
  training.run(*backend, known.data());
  EXPECT_GT(known.psnr_db(*backend, training.model), 30);
}

TEST(SplatModel, ImagesAreHalvedWhileTheyAreCut) {
  const KnownScene known(120, 2);  // 128 x 96
  const auto level = [&](int pixels, double progress) {
    return level_at(image_levels(known.data(), pixels), progress, 0.6);
  };
  EXPECT_EQ(level(2048, 0), 2) << "64 x 48 would be cut, too";
  EXPECT_EQ(level(2048, 0.39), 2);
  EXPECT_EQ(level(2048, 0.41), 1);
  EXPECT_EQ(level(2048, 0.59), 1);
  EXPECT_EQ(level(2048, 0.61), 0);
  EXPECT_EQ(level(4096, 0), 1);
  EXPECT_EQ(level(4096, 0.61), 0);
  EXPECT_EQ(level(20000, 0), 0);
  SplatScene tiny;
  tiny.add_camera("TINY", "opencv_pinhole", {9, 9, 1, 1, 0, 0, 0, 0, 0}, 3, 3);
  tiny.add_view(0, Rigid3d::Identity(), false);
  tiny.finish();
  EXPECT_EQ(level_at(image_levels(tiny.data(), 20000), 0, 0.6), 0);
}

TEST(SplatModel, SizesThatTilesDoNotDivideAreCovered) {
  KnownScene known(60, 2.03);  // 129 x 97
  const int width = 129, height = 97;
  for (std::size_t v = 0; v < known.images.size(); ++v)
    if (!known.scene.views[v].held_out) {
      known.images[v].used.assign(width * height, 1);
      known.images[v].used.back() = 0;
    }
  const auto backend = fast_backend();
  Training training;
  training.begin(disturbed(known_gaussians(60), 0.06f));
  for (const int window : {400, 2048, 5000, 20000}) {
    training.model.window_pixels = window;
    training.buffers.method.reset();
    const std::int64_t windows = training.model.steps_per_epoch(known.data(), 1);
    for (const double progress : {0.1, 0.9}) {
      std::int64_t pixels = 0;
      StepRequest request;
      request.progress = progress;
      for (request.step = 0; request.step < windows; ++request.step) {
        pixels += training.gradients(*backend, known.data(), request).pixels;
        ASSERT_TRUE(std::isfinite(training.loss()));
        ASSERT_TRUE(std::ranges::all_of(training.buffers.gradients.span(),
                                        [](float x) { return std::isfinite(x); }));
      }
      if (progress > 0.5 || windows == 10) {
        EXPECT_EQ(pixels, 10 * (width * height - 1)) << window;
      }
    }
  }
}

// Without Gaussians an image is its background.
TEST(SplatModel, TransparentPixelsMatchAnyBackground) {
  for (const Background background : {Background::kWhite, Background::kBlack})
    for (const bool random : {false, true})
      for (const int window : {260000, 1024}) {
        SCOPED_TRACE(testing::Message() << int(background) << random << window);
        KnownScene known(8);
        known.scene.background = background;
        known.scene.random_background = random;
        known.scene.metric = false;
        for (std::size_t v = 0; v < known.images.size(); ++v)
          if (!known.scene.views[v].held_out) {
            std::ranges::fill(known.images[v].rgb, background == Background::kWhite ? 255 : 0);
            known.images[v].alpha.assign(64 * 48, 0);
          }
        const auto backend = fast_backend();
        Training training;
        training.model.configure(known.scene);
        training.model.window_pixels = window;
        training.begin({});
        StepRequest request;
        training.gradients(*backend, known.data(), request);
        EXPECT_LT(training.loss(), 1e-5);
        EXPECT_NEAR(training.buffers.workspace.sums().opacity, 0, 1e-6);
        const RenderedImage image = known.render(*backend, training.model, 0);
        for (const float x : image.rgb)
          EXPECT_EQ(x, background == Background::kWhite ? 1.0f : 0.0f);

        for (Image8& opaque : known.images) opaque.alpha.clear();
        training.buffers.method.reset();
        training.gradients(*backend, known.data(), request);
        EXPECT_EQ(training.loss() > 1e-3, random) << "opaque white is not background";
      }
}

// Grey images over a grey background do not tell how opaque the Gaussians are.
TEST(SplatModel, GaussiansBecomeOpaqueWhereTheBackgroundHasTheirColour) {
  const auto opacity = [](float weight) {
    KnownScene known(8);
    for (Image8& image : known.images) std::ranges::fill(image.rgb, 128);
    GaussianList list;  // a wall that fills the images, seen through
    const GaussianList like = known_gaussians(1);
    for (int y = -20; y <= 20; ++y)
      for (int x = -20; x <= 20; ++x) {
        const std::size_t first = list.rows.size();
        list.rows.insert(list.rows.end(), like.rows.begin(), like.rows.end());
        float* const rows = &list.rows[first];
        rows[kPositionRow] = 0.8f * static_cast<float>(x);
        rows[kPositionRow + 1] = 0.8f * static_cast<float>(y);
        rows[kPositionRow + 2] = 8;
        std::fill_n(rows + kLogScaleRow, 3, std::log(0.6f));
        std::fill_n(rows + kColourRow, kGaussianRows - kColourRow, 0.0f);
        std::fill_n(rows + kColourRow, 3, 128 / 255.0f);
        rows[kOpacityRow] = -2;
        rows[kDistanceRow] = 8;
      }
    const auto backend = fast_backend();
    Training training;
    training.model.opacity_weight = weight;
    training.steps = 200;
    training.begin(list);
    training.run(*backend, known.data());
    return training.buffers.workspace.sums().opacity;
  };
  const double without = opacity(0), with = opacity(0.05f);
  EXPECT_LT(without, 0.8);
  EXPECT_GT(with, 0.95);
}

TEST(SplatModel, PoseGradientsAreThoseOfTheLoss) {
  KnownScene known(25);
  const auto backend = kernels::make_ref_backend();
  Training training;
  training.begin(disturbed(known_gaussians(25), 0.05f));
  std::vector<bool> tested(4);
  for (std::int64_t step = 0; step < 10; ++step) {
    StepRequest request;
    request.step = step;
    request.pose_gradients = true;
    const StepOutput out = training.gradients(*backend, known.data(), request);
    ASSERT_EQ(out.views.size(), 12u);
    int drawn = -1;
    for (int v = 0; v < 12; ++v)
      if (out.views[v].d_translation.norm() + out.views[v].d_rotation.norm() > 0) {
        EXPECT_EQ(drawn, -1) << "one view a step";
        drawn = v;
      }
    ASSERT_GE(drawn, 0);
    const View& view = known.scene.views[drawn];
    EXPECT_FALSE(view.held_out);
    if (tested[view.camera]) continue;
    tested[view.camera] = true;
    SCOPED_TRACE(known.scene.rig[view.camera].name);
    request.pose_gradients = false;
    const std::vector<FramePose> before = known.scene.trajectory;
    constexpr double kStep = 2e-3;
    for (int k = 0; k < 6; ++k) {
      double loss[2];
      for (const int side : {0, 1}) {
        const Eigen::Vector3d by = (side ? kStep : -kStep) * Eigen::Vector3d::Unit(k % 3);
        known.scene.trajectory = before;
        for (FramePose& frame : known.scene.trajectory)
          if (k < 3)
            frame.global_from_body.translation() += by;
          else
            frame.global_from_body.linear() = so3_exp(by) * frame.global_from_body.linear();
        training.gradients(*backend, known.data(), request);
        loss[side] = training.loss();
      }
      known.scene.trajectory = before;
      const Eigen::Vector3d& d =
          k < 3 ? out.views[drawn].d_translation : out.views[drawn].d_rotation;
      // Pixels at kMinAlpha come and go, and absolute errors have kinks.
      EXPECT_NEAR(d[k % 3], (loss[1] - loss[0]) / (2 * kStep), 0.05 * d.norm()) << k;
    }
  }
  EXPECT_EQ(std::ranges::count(tested, true), 4) << "cameras";
}

TEST(SplatModel, PhotographsHaveExposures) {
  KnownScene known;
  known.scene.metric = false;
  SplatModel model;
  model.configure(known.scene);
  EXPECT_EQ(model.gains.appearance.cameras, 4);
  EXPECT_EQ(model.gains.appearance.knots, 12);
  EXPECT_EQ(model.gains.shading.size(), 0u);
  SplatModel object;
  known.scene.background = Background::kWhite;
  object.configure(known.scene);
  EXPECT_EQ(object.gains.size(), 0u);
  SplatModel each_its_camera;
  known.scene.background = Background::kNone;
  known.scene.rig.resize(17, known.scene.rig[0]);
  each_its_camera.configure(known.scene);
  EXPECT_EQ(each_its_camera.gains.size(), 0u);
}

TEST(SplatModel, ThreadsChangeNoBit) {
  const KnownScene known;
  Training one, four;
  for (Training* training : {&one, &four}) {
    training->steps = 60;
    training->begin(disturbed(known_gaussians(120), 0.05f));
    training->model.max_gaussians = 150;
    training->model.densify_every = 20;
    training->run(*fast_backend(training == &one ? 1 : 4), known.data());
  }
  ASSERT_EQ(one.model.gaussians, four.model.gaussians);
  EXPECT_EQ(std::memcmp(one.model.parameters.data(), four.model.parameters.data(),
                        one.model.parameters.size() * sizeof(float)),
            0);
}

TEST(SplatModel, ShortRecordingsHaveFewerGaussians) {
  SplatScene scene;
  scene.add_camera("LARGE", "opencv_pinhole", {900, 900, 959.5, 539.5, 0, 0, 0, 0, 0}, 1920, 1080);
  for (int i = 0; i < 3; ++i) scene.add_view(0, Rigid3d::Identity(), i == 2);
  SplatModel model;
  model.configure(scene.scene);
  EXPECT_EQ(model.most_gaussians(), 2 * 1920 * 1080 / 64) << "held-out images do not count";
  model.max_gaussians = 1000;
  EXPECT_EQ(model.most_gaussians(), 1000);
}

}  // namespace
}  // namespace redrive::known_splats
