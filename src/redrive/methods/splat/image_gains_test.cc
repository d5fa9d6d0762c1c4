// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/image_gains.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/kernels/gaussian/pixel_gains.h"

namespace redrive {
namespace {

constexpr int kWidth = 128, kHeight = 96;

ImageGains two_cameras() {
  ImageGains gains;
  gains.appearance.cameras = gains.shading.cameras = 2;
  gains.appearance.knots = 4;
  gains.appearance.knot_spacing_s = 0.1f;
  gains.shading.columns = 8;
  gains.shading.rows = 6;
  return gains;
}

/// Writes the gains of each pixel, 3 planes of `size`.
void write_planes(const ImageGains& gains, const std::vector<float>& parameters,
                  const Exposure& exposure, const kernels::RasterSize& size, const ImagePart& part,
                  std::span<float> planes) {
  for (int c = 0; c < 3; ++c)
    for (int y = 0; y < size.rows; ++y)
      kernels::write_gains(
          gains.of(parameters, exposure), part, y, c,
          planes.subspan(c * size.plane() + std::size_t(y) * size.stride, size.stride));
}

/// Brightness of the patches of an image that is rendered with `rendered` before gains, and of
/// ground truth that has the gains truth(patch's centre as parts of the image) instead.
template <class Truth>
std::vector<kernels::PatchBrightness> brightness(const std::vector<float>& planes,
                                                 const kernels::RasterSize& size,
                                                 const ImagePart& part, float rendered,
                                                 const Truth& truth) {
  std::vector<kernels::PatchBrightness> patches(size.plane() / 64);
  for (int c = 0; c < 3; ++c)
    for (int y = 0; y < size.height; ++y)
      for (int x = 0; x < size.width; ++x) {
        kernels::PatchBrightness& patch = patches[y / 8 * (size.stride / 8) + x / 8];
        patch.pixels[c] += 1;
        patch.target[c] += rendered * truth((part.x + x + 0.5f) / part.image_width,
                                            (part.y + y + 0.5f) / part.image_height, c);
        patch.rendered[c] += rendered * planes[c * size.plane() + y * size.stride + x];
      }
  return patches;
}

TEST(ExposureTimes, FindTheNearestOtherTrainingImagesOfACamera) {
  constexpr float kEver = std::numeric_limits<float>::infinity();
  Scene scene;
  scene.rig.resize(2);
  for (const std::int64_t t_s : {0, 1, 2, 4, 8}) scene.frames.push_back({t_s, t_s * 1'000'000'000});
  const auto add = [&](int camera, int frame, bool held_out) {
    View& view = scene.views.emplace_back();
    view.camera = camera;
    view.frame = frame;
    view.held_out = held_out;
  };
  for (const int frame : {4, 0, 3, 1}) add(0, frame, false);
  add(0, 2, true);
  add(1, 2, false);
  const ExposureTimes times(scene);
  const auto expect = [&](const Exposure& at, float before_s, float after_s) {
    const ExposureGaps gaps = times.gaps(at);
    EXPECT_EQ(gaps.before_s, before_s) << at.camera << ", " << at.t_s;
    EXPECT_EQ(gaps.after_s, after_s) << at.camera << ", " << at.t_s;
  };
  expect({0, 1}, 1, 3);
  expect({0, 2}, 1, 2);
  expect({0, 0}, kEver, 1);
  expect({0, 8}, 4, kEver);
  expect({1, 2}, kEver, kEver);
}

TEST(ImageGains, FindTheLightThatMovesWithTheCamera) {
  ImageGains gains = two_cameras();
  gains.shading_threshold = gains.exposure_decay = 0;
  std::vector<float> parameters(gains.size());
  const auto truth = [](float x, float y, int c) {
    return (0.5f + 0.1f * c) * std::exp(-2 * ((x - 0.5f) * (x - 0.5f) + (y - 0.6f) * (y - 0.6f)));
  };
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight / 2);
  std::vector<float> planes(3 * size.plane());
  for (int step = 0; step < 800; ++step) {  // halves of an image in turn
    const ImagePart part{0, step % 2 * kHeight / 2, kWidth, kHeight};
    const Exposure exposure{1, 0.1f * static_cast<float>(step / 2 % 4)};
    write_planes(gains, parameters, exposure, size, part, planes);
    std::vector<float> changes(parameters.size());
    gains.add_changes(parameters, exposure, {}, size, part,
                      brightness(planes, size, part, 0.4f, truth), 1, changes);
    for (std::size_t i = 0; i < changes.size(); ++i) parameters[i] += changes[i];
  }
  const ImagePart part{0, 0, kWidth, kHeight};
  const kernels::RasterSize whole = kernels::raster_size(kWidth, kHeight);
  planes.resize(3 * whole.plane());
  write_planes(gains, parameters, {1, 0.15f}, whole, part, planes);
  for (int c = 0; c < 3; ++c)
    for (int y = 8; y < kHeight - 8; y += 5)
      for (int x = 8; x < kWidth - 8; x += 5)
        EXPECT_NEAR(planes[c * whole.plane() + y * whole.stride + x],
                    truth((x + 0.5f) / kWidth, (y + 0.5f) / kHeight, c), 0.03f)
            << x << " " << y;
  write_planes(gains, parameters, {0, 0.15f}, whole, part, planes);
  for (const float gain : planes) EXPECT_EQ(gain, 1) << "the other camera";
}

TEST(ImageGains, BetweenTrainingImagesAreInterpolated) {
  constexpr float kEver = std::numeric_limits<float>::infinity();
  ImageGains gains = two_cameras();
  gains.appearance.knots = 7;
  gains.exposure_decay = gains.exposure_share = 0;
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight);
  const ImagePart part{0, 0, kWidth, kHeight};
  std::vector<float> parameters(gains.size()), planes(3 * size.plane());
  // Training images at knots 1, 2 and 5.
  const struct {
    Exposure exposure;
    ExposureGaps gaps;
    float truth;
  } images[] = {{{1, 0.1f}, {kEver, 0.1f}, 0.8f},
                {{1, 0.2f}, {0.1f, 0.3f}, 1},
                {{1, 0.5f}, {0.3f, kEver}, 1.25f}};
  for (int step = 0; step < 150; ++step) {
    const auto& image = images[step % 3];
    write_planes(gains, parameters, image.exposure, size, part, planes);
    std::vector<float> changes(parameters.size());
    gains.add_changes(
        parameters, image.exposure, image.gaps, size, part,
        brightness(planes, size, part, 0.4f, [&](float, float, int) { return image.truth; }), 1,
        changes);
    for (std::size_t i = 0; i < changes.size(); ++i)
      if (i < gains.appearance.size()) parameters[i] += changes[i];
  }
  const float log_gains[] = {-1, -1, 0, 1 / 3.0f, 2 / 3.0f, 1, 1};
  for (int knot = 0; knot < 7; ++knot) {
    write_planes(gains, parameters, {1, 0.1f * static_cast<float>(knot)}, size, part, planes);
    EXPECT_NEAR(std::log(planes[0]) / std::log(1.25f), log_gains[knot], 1e-3f) << knot;
  }
}

TEST(ImageGains, OfAnImageThatAgreesDecay) {
  const ImageGains gains = two_cameras();
  std::vector<float> parameters(gains.size(), 0.5f);
  const ImagePart part{0, 0, kWidth, kHeight};
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight);
  std::vector<float> planes(3 * size.plane()), changes(parameters.size());
  write_planes(gains, parameters, {0, 0}, size, part, planes);
  const float gain = planes[0];
  gains.add_changes(parameters, {0, 0}, {}, size, part,
                    brightness(planes, size, part, 0.4f, [&](float, float, int) { return gain; }),
                    1, changes);
  const std::size_t of_exposure = gains.appearance.size(), cells = 3 * gains.shading.cells();
  EXPECT_LT(changes[0], 0);
  EXPECT_NEAR(changes[of_exposure], -gains.shading_rate * gains.shading_threshold, 1e-6);
  for (std::size_t i = 0; i < cells; ++i)
    EXPECT_EQ(changes[of_exposure + cells + i], 0) << "the other camera";
}

TEST(ImageGains, ShadingIsBounded) {
  const ImageGains gains = two_cameras();
  std::vector<float> parameters(gains.size());
  const ImagePart part{0, 0, kWidth, kHeight};
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight);
  std::vector<float> planes(3 * size.plane());
  for (int step = 0; step < 200; ++step) {  // one half black, the other as rendered
    write_planes(gains, parameters, {0, 0}, size, part, planes);
    std::vector<float> changes(parameters.size());
    gains.add_changes(parameters, {0, 0}, {}, size, part,
                      brightness(planes, size, part, 0.9f,
                                 [](float x, float, int) { return x < 0.5f ? 0.0f : 1.0f; }),
                      1, changes);
    for (std::size_t i = 0; i < changes.size(); ++i) parameters[i] += changes[i];
  }
  const std::span<const float> cells =
      std::span<const float>(parameters).subspan(gains.appearance.size(), gains.shading.cells());
  EXPECT_EQ(std::ranges::min(cells), -1.5f);
  for (const float cell : cells) EXPECT_LE(std::fabs(cell), 1.5f);
}

TEST(ImageGains, WhatIsMaskedStays) {
  const ImageGains gains = two_cameras();
  std::vector<float> parameters(gains.size()), changes(gains.size());
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight);
  std::vector<kernels::PatchBrightness> patches(size.plane() / 64);
  gains.add_changes(parameters, {0, 0}, {}, size, {0, 0, kWidth, kHeight}, patches, 1, changes);
  for (const float change : changes) EXPECT_EQ(change, 0);
}

TEST(ImageGains, AnImageMovesTheKnotsAroundItByTheirWeights) {
  const ImageGains gains = two_cameras();
  std::vector<float> parameters(gains.size()), changes(gains.size());
  const kernels::RasterSize size = kernels::raster_size(kWidth, kHeight);
  std::vector<kernels::PatchBrightness> patches(size.plane() / 64);
  for (kernels::PatchBrightness& patch : patches)
    for (int c = 0; c < 3; ++c) {
      patch.pixels[c] = 64;
      patch.target[c] = 15;
      patch.rendered[c] = 30;
    }
  gains.add_changes(parameters, {1, 0.175f}, {}, size, {0, 0, kWidth, kHeight}, patches, 1,
                    changes);
  // Knots of camera 1, of 0, 0.1, 0.2, 0.3 s.
  const float all = changes[12];
  EXPECT_LT(all, 0);
  EXPECT_EQ(changes[21], all);
  EXPECT_NEAR((changes[15] - all) / (changes[18] - all), 1.0 / 3, 1e-4);
  EXPECT_NEAR(all / (changes[15] + changes[18] - all), gains.exposure_share, 1e-4);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(changes[i], 0) << "the other camera";
}

}  // namespace
}  // namespace redrive
