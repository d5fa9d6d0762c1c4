// SPDX-License-Identifier: Apache-2.0
// Image scores of every backend against values that follow from their formulas, and against the
// oracle.
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "candidates.h"
#include "redrive/base/rng.h"

namespace redrive::kernels::conformance {
namespace {

// Rounding of vectors and devices, which compute in float. FLIP takes powers of approximate
// logarithms.
constexpr double kDecibels = 1e-5, kSsim = 1e-5, kFlip = 2e-5;

class ImageScoreStages : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, ImageScoreStages, testing::ValuesIn(splat_candidates()),
                         name_of);

struct TestImages {
  int width, height;
  std::vector<float> rgb;
  std::vector<std::uint8_t> ground_truth, mask;

  std::size_t pixels() const { return static_cast<std::size_t>(width) * height; }
  ImageScore by(Backend& backend) const {
    return backend.score({width, height, rgb, ground_truth, mask});
  }
  /// Exchanges image and ground truth.
  TestImages swapped() const {
    TestImages out = {width, height, {}, {}, mask};
    for (const std::uint8_t value : ground_truth)
      out.rgb.push_back(static_cast<float>(value) / 255.0f);
    for (const float value : rgb)
      out.ground_truth.push_back(static_cast<std::uint8_t>(std::lround(255 * value)));
    return out;
  }
};

using Rgb = std::array<float, 3>;
using Rgb8 = std::array<std::uint8_t, 3>;

TestImages uniform_images(int width, int height, const Rgb& rgb, const Rgb8& ground_truth) {
  TestImages images{width, height, {}, {}, {}};
  for (int i = 0; i < width * height; ++i) {
    images.rgb.insert(images.rgb.end(), rgb.begin(), rgb.end());
    images.ground_truth.insert(images.ground_truth.end(), ground_truth.begin(), ground_truth.end());
  }
  return images;
}

/// Returns a ground truth of noise and an image with additional noise, in multiples of 1/255.
TestImages noisy_images(int width, int height) {
  TestImages images{width, height, {}, {}, {}};
  for (std::size_t i = 0; i < 3 * images.pixels(); ++i) {
    const double ground_truth = random_unit(random_key(1, kStreamTest, 0), i),
                 other = random_unit(random_key(1, kStreamTest, 1), i);
    images.ground_truth.push_back(static_cast<std::uint8_t>(std::lround(255 * ground_truth)));
    images.rgb.push_back(static_cast<float>(std::lround(255 * (0.7 * ground_truth + 0.3 * other))) /
                         255.0f);
  }
  return images;
}

/// Masks a bar and some pixels, whose colours become NaN.
void mask_some(TestImages* images) {
  images->mask.assign(images->pixels(), 1);
  for (std::size_t i = 0; i < images->pixels(); ++i) {
    if (i % images->width >= 7 && i % 13 != 2) continue;
    images->mask[i] = 0;
    images->rgb[3 * i + 1] = NAN;
  }
}

TEST_P(ImageScoreStages, PsnrFollowsItsDefinition) {
  const auto backend = make();
  EXPECT_NEAR(uniform_images(4, 3, {0.7f, 0.7f, 0.7f}, {51, 51, 51}).by(*backend).psnr_db,
              -20 * std::log10(double{0.7f} - 51 / 255.0f), kDecibels);
  // One of 12 x 3 values is off by 1: MSE = 1/36.
  TestImages one = uniform_images(4, 3, {0, 0, 0}, {0, 0, 0});
  EXPECT_EQ(one.by(*backend).psnr_db, std::numeric_limits<double>::infinity());
  one.rgb[3 * 5 + 2] = 1;
  EXPECT_NEAR(one.by(*backend).psnr_db, 10 * std::log10(36.0), kDecibels);
  one.mask.assign(12, 1);
  one.mask[0] = one.mask[1] = 0;
  EXPECT_NEAR(one.by(*backend).psnr_db, 10 * std::log10(30.0), kDecibels) << "10 pixels";
  one.mask[5] = 0;
  EXPECT_EQ(one.by(*backend).psnr_db, std::numeric_limits<double>::infinity());
}

// Luma is the mean of the channels: errors of opposite sign cancel there.
TEST_P(ImageScoreStages, PsnrByChannelAndOfLuma) {
  const auto backend = make();
  const ImageScore score = uniform_images(4, 3, {0.5f, 0.25f, 0.5f}, {51, 51, 0}).by(*backend);
  const auto psnr_db = [](double error) { return -20 * std::log10(std::fabs(error)); };
  EXPECT_NEAR(score.channel_psnr_db[0], psnr_db(0.3), kDecibels);
  EXPECT_NEAR(score.channel_psnr_db[1], psnr_db(0.05), kDecibels);
  EXPECT_NEAR(score.channel_psnr_db[2], psnr_db(0.5), kDecibels);
  EXPECT_NEAR(score.luma_psnr_db, psnr_db(0.85 / 3), kDecibels);
  const ImageScore cancelled = uniform_images(4, 3, {0.3f, 0.1f, 0.2f}, {51, 51, 51}).by(*backend);
  EXPECT_GT(cancelled.luma_psnr_db, 120);
  EXPECT_NEAR(cancelled.channel_psnr_db[0], psnr_db(0.1), kDecibels);
}

TEST_P(ImageScoreStages, ReturnsNaNWhereEverythingIsMasked) {
  const auto backend = make();
  TestImages images = noisy_images(20, 15);
  images.mask.assign(images.pixels(), 0);
  const ImageScore none = images.by(*backend), narrow = noisy_images(10, 30).by(*backend);
  EXPECT_TRUE(std::isnan(none.psnr_db) && std::isnan(none.ssim) && std::isnan(none.flip));
  EXPECT_TRUE(std::isnan(narrow.ssim)) << "no window fits in";
  EXPECT_TRUE(std::isfinite(narrow.psnr_db) && std::isfinite(narrow.flip));
}

TEST_P(ImageScoreStages, EqualImagesScorePerfectly) {
  TestImages images = noisy_images(23, 17);
  images.rgb = images.swapped().rgb;
  const ImageScore score = images.by(*make());
  EXPECT_EQ(score.psnr_db, std::numeric_limits<double>::infinity());
  EXPECT_NEAR(score.ssim, 1, kSsim);
  EXPECT_NEAR(score.flip, 0, kFlip);  // a rounding error to the power of 0.7
}

TEST_P(ImageScoreStages, IsSymmetric) {
  const auto backend = make();
  const TestImages images = noisy_images(29, 31);
  const ImageScore one = images.by(*backend), other = images.swapped().by(*backend);
  EXPECT_NEAR(one.psnr_db, other.psnr_db, kDecibels);
  EXPECT_NEAR(one.ssim, other.ssim, kSsim);
  EXPECT_NEAR(one.flip, other.flip, kFlip);
  EXPECT_GT(one.flip, 0.1);
  EXPECT_LT(one.flip, 1);
}

// Variances are differences of means of values below 1, which err by 6e-8 and count relative to
// C2 = 9e-4. In images with contrast such errors cancel.
constexpr double kFlatSsim = 3 * 6e-8 / 9e-4;

TEST_P(ImageScoreStages, SsimOfUniformImagesFollowsTheClosedForm) {
  const double a = 0.75, b = 51 / 255.0f, c1 = 1e-4;
  EXPECT_NEAR(uniform_images(20, 15, {0.75f, 0.75f, 0.75f}, {51, 51, 51}).by(*make()).ssim,
              (2 * a * b + c1) / (a * a + b * b + c1), kFlatSsim);
}

/// Computes SSIM by its definition: each window separately, variances as means of squared
/// deviations.
double ssim_by_brute_force(const TestImages& images) {
  double sum = 0;
  int windows = 0;
  for (int channel = 0; channel < 3; ++channel)
    for (int row = 5; row < images.height - 5; ++row)
      for (int column = 5; column < images.width - 5; ++column, ++windows) {
        double total = 0, mx = 0, my = 0, vx = 0, vy = 0, cov = 0;
        const auto walk = [&](auto&& visit) {
          for (int dy = -5; dy <= 5; ++dy)
            for (int dx = -5; dx <= 5; ++dx) {
              const int i = 3 * ((row + dy) * images.width + column + dx) + channel;
              visit(std::exp(-(dx * dx + dy * dy) / (2 * 1.5 * 1.5)), images.rgb[i],
                    images.ground_truth[i] / 255.0f);
            }
        };
        walk([&](double w, double, double) { total += w; });
        walk([&](double w, double a, double b) { mx += w / total * a, my += w / total * b; });
        walk([&](double w, double a, double b) {
          vx += w / total * (a - mx) * (a - mx);
          vy += w / total * (b - my) * (b - my);
          cov += w / total * (a - mx) * (b - my);
        });
        sum += (2 * mx * my + 1e-4) * (2 * cov + 9e-4) /
               ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
      }
  return sum / windows;
}

TEST_P(ImageScoreStages, SsimAgreesWithBruteForce) {
  const TestImages images = noisy_images(31, 24);
  const double expected = ssim_by_brute_force(images);
  EXPECT_GT(expected, 0.5);
  EXPECT_LT(expected, 0.99);
  EXPECT_NEAR(images.by(*make()).ssim, expected, kSsim);
}

TEST_P(ImageScoreStages, SsimIgnoresMaskedWindowsAndPixels) {
  const auto backend = make();
  TestImages images = noisy_images(40, 12);  // windows in rows 5 and 6, columns 5..34
  images.rgb = images.swapped().rgb;
  for (std::size_t i = 0; i < images.pixels(); ++i) {
    images.mask.push_back(i % images.width < 20);
    if (!images.mask[i])
      for (int c = 0; c < 3; ++c) images.rgb[3 * i + c] = 0.5f;  // different, but masked
  }
  const ImageScore masked = images.by(*backend);
  EXPECT_NEAR(masked.ssim, 1, kSsim);
  EXPECT_NEAR(masked.flip, 0, kFlip);
  images.mask.clear();
  const ImageScore all = images.by(*backend);
  EXPECT_LT(all.ssim, 0.9);
  EXPECT_GT(all.flip, 0.01);
}

// Uniform images have no features, so only the colour difference counts, and filters do not change
// it. L*a*b* (D65): green 87.735, -86.183, 83.179; blue 32.297, 79.188, -107.860. With chroma times
// L / 100 their HyAB distance is 55.438 + |(-75.612 - 25.575, 72.977 + 34.836)| = 203.30; to the
// power of 0.7, 41.28, the largest difference. Black and white: 100^0.7 = 25.119, above the knee at
// 0.4 * 41.28 = 16.51: 0.95 + 0.05 (25.119 - 16.51) / (41.28 - 16.51).
TEST_P(ImageScoreStages, FlipOfUniformImagesFollowsTheClosedForm) {
  const auto backend = make();
  EXPECT_NEAR(uniform_images(48, 32, {0, 0, 0}, {255, 255, 255}).by(*backend).flip, 0.9674, 2e-4);
  EXPECT_NEAR(uniform_images(48, 32, {0, 1, 0}, {0, 0, 255}).by(*backend).flip, 1, kFlip);
  // sRGB 0.5 and 0.6 are linear 0.21404 and 0.31855: L* 53.389 and 63.223; 9.834^0.7 = 4.952, times
  // 0.95 / 16.51.
  EXPECT_NEAR(uniform_images(48, 32, {0.5f, 0.5f, 0.5f}, {153, 153, 153}).by(*backend).flip, 0.2849,
              5e-4);
}

// Light adds linearly: from afar a checkerboard looks like the grey of linear 0.5, sRGB 0.7354.
// Single pixels (67 per degree) are below the eye's resolution, squares of 16 are not.
TEST_P(ImageScoreStages, FlipIgnoresDetailBelowTheEyesResolution) {
  const auto backend = make();
  for (const int size : {1, 16}) {
    TestImages images = uniform_images(48, 32, {0.7354f, 0.7354f, 0.7354f}, {0, 0, 0});
    for (std::size_t i = 0; i < images.pixels(); ++i)
      if ((i % 48 / size + i / 48 / size) % 2 == 1)
        for (int c = 0; c < 3; ++c) images.ground_truth[3 * i + c] = 255;
    const double flip = images.by(*backend).flip;
    if (size == 1)
      EXPECT_LT(flip, 0.2);
    else
      EXPECT_GT(flip, 0.7);
  }
}

TEST_P(ImageScoreStages, MatchesRefForAnyNumberOfThreads) {
  const auto oracle = make_ref_backend();
  for (const auto& [width, height] : {std::pair(1, 1), {24, 40}, {97, 75}})
    for (const bool masked : {false, true}) {
      SCOPED_TRACE(std::to_string(width) + " x " + std::to_string(height) +
                   (masked ? ", masked" : ""));
      TestImages images = noisy_images(width, height);
      if (masked && width > 1) mask_some(&images);
      const ImageScore expected = images.by(*oracle);
      EXPECT_FALSE(std::isnan(expected.psnr_db));
      const ImageScore one = images.by(*make(1)), three = images.by(*make(3));
      EXPECT_EQ(three.psnr_db, one.psnr_db);
      EXPECT_EQ(three.flip, one.flip);
      EXPECT_NEAR(one.psnr_db, expected.psnr_db, kDecibels);
      EXPECT_NEAR(one.luma_psnr_db, expected.luma_psnr_db, kDecibels);
      EXPECT_NEAR(one.flip, expected.flip, kFlip);
      if (width <= 10) continue;
      EXPECT_EQ(three.ssim, one.ssim);
      EXPECT_NEAR(one.ssim, expected.ssim, kSsim);
    }
}

// Scores by the code that made the figures of docs/benchmarks.md.
TEST_P(ImageScoreStages, MatchesRecordedScores) {
  const auto backend = make();
  TestImages images = noisy_images(97, 75);
  const ImageScore all = images.by(*backend);
  EXPECT_NEAR(all.psnr_db, 18.234837751777189, kDecibels);
  EXPECT_NEAR(all.ssim, 0.88233605215964772, kSsim);
  EXPECT_NEAR(all.flip, 0.25442253651159041, kFlip);
  mask_some(&images);
  const ImageScore masked = images.by(*backend);
  EXPECT_NEAR(masked.psnr_db, 18.225782435166757, kDecibels);
  EXPECT_NEAR(masked.ssim, 0.90952571984786368, kSsim);
  EXPECT_NEAR(masked.flip, 0.25127490627456062, kFlip);
}

}  // namespace
}  // namespace redrive::kernels::conformance
