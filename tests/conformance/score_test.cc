// SPDX-License-Identifier: Apache-2.0
// Scores of pictures, of every backend: answers that follow from their formulas, and those of the
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

class ImageScoreStages : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, ImageScoreStages, testing::ValuesIn(candidates()), name_of);

struct Pictures {
  int width, height;
  std::vector<float> rgb;
  std::vector<std::uint8_t> truth, mask;

  std::size_t pixels() const { return static_cast<std::size_t>(width) * height; }
  ImageScore by(Backend& backend) const { return backend.score({width, height, rgb, truth, mask}); }
  /// The other way round.
  Pictures swapped() const {
    Pictures out = {width, height, {}, {}, mask};
    for (const std::uint8_t value : truth) out.rgb.push_back(static_cast<float>(value) / 255.0f);
    for (const float value : rgb)
      out.truth.push_back(static_cast<std::uint8_t>(std::lround(255 * value)));
    return out;
  }
};

using Rgb = std::array<float, 3>;
using Rgb8 = std::array<std::uint8_t, 3>;

Pictures uniform_pictures(int width, int height, const Rgb& rgb, const Rgb8& truth) {
  Pictures pictures{width, height, {}, {}, {}};
  for (int i = 0; i < width * height; ++i) {
    pictures.rgb.insert(pictures.rgb.end(), rgb.begin(), rgb.end());
    pictures.truth.insert(pictures.truth.end(), truth.begin(), truth.end());
  }
  return pictures;
}

/// Noise, of which the picture has some more than the truth; whole 255ths.
Pictures noisy_pictures(int width, int height) {
  Pictures pictures{width, height, {}, {}, {}};
  for (std::size_t i = 0; i < 3 * pictures.pixels(); ++i) {
    const double truth = random_unit(random_key(1, kStreamTest, 0), i),
                 other = random_unit(random_key(1, kStreamTest, 1), i);
    pictures.truth.push_back(static_cast<std::uint8_t>(std::lround(255 * truth)));
    pictures.rgb.push_back(static_cast<float>(std::lround(255 * (0.7 * truth + 0.3 * other))) /
                           255.0f);
  }
  return pictures;
}

/// A bar and some pixels, of which the picture says what is no number.
void mask_some(Pictures* pictures) {
  pictures->mask.assign(pictures->pixels(), 1);
  for (std::size_t i = 0; i < pictures->pixels(); ++i) {
    if (i % pictures->width >= 7 && i % 13 != 2) continue;
    pictures->mask[i] = 0;
    pictures->rgb[3 * i + 1] = NAN;
  }
}

TEST_P(ImageScoreStages, PsnrIsTenLogOfTheInverseMeanSquare) {
  const auto backend = make();
  EXPECT_DOUBLE_EQ(uniform_pictures(4, 3, {0.7f, 0.7f, 0.7f}, {51, 51, 51}).by(*backend).psnr_db,
                   -20 * std::log10(double{0.7f} - 51 / 255.0f));
  // One of 12 x 3 values off by 1: MSE = 1/36.
  Pictures one = uniform_pictures(4, 3, {0, 0, 0}, {0, 0, 0});
  EXPECT_EQ(one.by(*backend).psnr_db, std::numeric_limits<double>::infinity());
  one.rgb[3 * 5 + 2] = 1;
  EXPECT_DOUBLE_EQ(one.by(*backend).psnr_db, 10 * std::log10(36.0));
  one.mask.assign(12, 1);
  one.mask[0] = one.mask[1] = 0;
  EXPECT_DOUBLE_EQ(one.by(*backend).psnr_db, 10 * std::log10(30.0)) << "10 pixels";
  one.mask[5] = 0;
  EXPECT_EQ(one.by(*backend).psnr_db, std::numeric_limits<double>::infinity());
}

TEST_P(ImageScoreStages, ReturnsNaNWhereEverythingIsMasked) {
  const auto backend = make();
  Pictures pictures = noisy_pictures(20, 15);
  pictures.mask.assign(pictures.pixels(), 0);
  const ImageScore none = pictures.by(*backend), narrow = noisy_pictures(10, 30).by(*backend);
  EXPECT_TRUE(std::isnan(none.psnr_db) && std::isnan(none.ssim) && std::isnan(none.flip));
  EXPECT_TRUE(std::isnan(narrow.ssim)) << "no window fits in";
  EXPECT_TRUE(std::isfinite(narrow.psnr_db) && std::isfinite(narrow.flip));
}

TEST_P(ImageScoreStages, EqualImagesScorePerfectly) {
  Pictures pictures = noisy_pictures(23, 17);
  pictures.rgb = pictures.swapped().rgb;
  const ImageScore score = pictures.by(*make());
  EXPECT_EQ(score.psnr_db, std::numeric_limits<double>::infinity());
  EXPECT_NEAR(score.ssim, 1, 1e-15);
  EXPECT_EQ(score.flip, 0);
}

TEST_P(ImageScoreStages, IsSymmetric) {
  const auto backend = make();
  const Pictures pictures = noisy_pictures(29, 31);
  const ImageScore one = pictures.by(*backend), other = pictures.swapped().by(*backend);
  EXPECT_DOUBLE_EQ(one.psnr_db, other.psnr_db);
  EXPECT_DOUBLE_EQ(one.ssim, other.ssim);
  EXPECT_NEAR(one.flip, other.flip, 1e-7);
  EXPECT_GT(one.flip, 0.1);
  EXPECT_LT(one.flip, 1);
}

// Variances are differences of sums of 121 products below 1: 121 x 2.2e-16, against C2 = 9e-4.
constexpr double kSsimRoundoff = 121 * 2.3e-16 / 9e-4;

TEST_P(ImageScoreStages, SsimOfUniformImagesFollowsTheClosedForm) {
  const double a = 0.75, b = 51 / 255.0f, c1 = 1e-4;
  EXPECT_NEAR(uniform_pictures(20, 15, {0.75f, 0.75f, 0.75f}, {51, 51, 51}).by(*make()).ssim,
              (2 * a * b + c1) / (a * a + b * b + c1), kSsimRoundoff);
}

/// Straight from the definition: every window on its own, variances as means of squared deviations.
double ssim_by_brute_force(const Pictures& pictures) {
  double sum = 0;
  int windows = 0;
  for (int channel = 0; channel < 3; ++channel)
    for (int row = 5; row < pictures.height - 5; ++row)
      for (int column = 5; column < pictures.width - 5; ++column, ++windows) {
        double total = 0, mx = 0, my = 0, vx = 0, vy = 0, cov = 0;
        const auto walk = [&](auto&& visit) {
          for (int dy = -5; dy <= 5; ++dy)
            for (int dx = -5; dx <= 5; ++dx) {
              const int i = 3 * ((row + dy) * pictures.width + column + dx) + channel;
              visit(std::exp(-(dx * dx + dy * dy) / (2 * 1.5 * 1.5)), pictures.rgb[i],
                    pictures.truth[i] / 255.0f);
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

TEST_P(ImageScoreStages, SsimAgreesWithEveryWindowOnItsOwn) {
  const Pictures pictures = noisy_pictures(31, 24);
  const double expected = ssim_by_brute_force(pictures);
  EXPECT_GT(expected, 0.5);
  EXPECT_LT(expected, 0.99);
  EXPECT_NEAR(pictures.by(*make()).ssim, expected, 4 * kSsimRoundoff);
}

TEST_P(ImageScoreStages, MaskedWindowsDoNotCountAndMaskedPixelsAreEqual) {
  const auto backend = make();
  Pictures pictures = noisy_pictures(40, 12);  // windows in rows 5 and 6, columns 5..34
  pictures.rgb = pictures.swapped().rgb;
  for (std::size_t i = 0; i < pictures.pixels(); ++i) {
    pictures.mask.push_back(i % pictures.width < 20);
    if (!pictures.mask[i])
      for (int c = 0; c < 3; ++c) pictures.rgb[3 * i + c] = 0.5f;  // wrong, but masked
  }
  const ImageScore masked = pictures.by(*backend);
  EXPECT_NEAR(masked.ssim, 1, 1e-15);
  EXPECT_EQ(masked.flip, 0);
  pictures.mask.clear();
  const ImageScore all = pictures.by(*backend);
  EXPECT_LT(all.ssim, 0.9);
  EXPECT_GT(all.flip, 0.01);
}

// Uniform pictures have no features, so only colour counts, and filters leave it as it is.
// L*a*b* (D65): green 87.735, -86.183, 83.179; blue 32.297, 79.188, -107.860. With chroma times L /
// 100 their HyAB distance is 55.438 + |(-75.612 - 25.575, 72.977 + 34.836)| = 203.30; to the power
// of 0.7, 41.28: the largest difference. Black and white: 100^0.7 = 25.119, beyond the knee at 0.4
// * 41.28 = 16.51: 0.95 + 0.05 (25.119 - 16.51) / (41.28 - 16.51).
TEST_P(ImageScoreStages, FlipOfUniformImagesByHand) {
  const auto backend = make();
  EXPECT_NEAR(uniform_pictures(48, 32, {0, 0, 0}, {255, 255, 255}).by(*backend).flip, 0.9674, 2e-4);
  EXPECT_NEAR(uniform_pictures(48, 32, {0, 1, 0}, {0, 0, 255}).by(*backend).flip, 1, 1e-5);
  // sRGB 0.5 and 0.6 are linear 0.21404 and 0.31855: L* 53.389 and 63.223; 9.834^0.7 = 4.952, times
  // 0.95 / 16.51.
  EXPECT_NEAR(uniform_pictures(48, 32, {0.5f, 0.5f, 0.5f}, {153, 153, 153}).by(*backend).flip,
              0.2849, 5e-4);
}

// Light adds linearly: from afar a checkerboard is the grey of linear 0.5, sRGB 0.7354. Single
// pixels (67 of them make a degree) are beyond what the eye resolves, squares of 16 are not.
TEST_P(ImageScoreStages, FlipHardlyCountsWhatTheEyeCannotResolve) {
  const auto backend = make();
  for (const int size : {1, 16}) {
    Pictures pictures = uniform_pictures(48, 32, {0.7354f, 0.7354f, 0.7354f}, {0, 0, 0});
    for (std::size_t i = 0; i < pictures.pixels(); ++i)
      if ((i % 48 / size + i / 48 / size) % 2 == 1)
        for (int c = 0; c < 3; ++c) pictures.truth[3 * i + c] = 255;
    const double flip = pictures.by(*backend).flip;
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
      Pictures pictures = noisy_pictures(width, height);
      if (masked && width > 1) mask_some(&pictures);
      const ImageScore expected = pictures.by(*oracle);
      EXPECT_FALSE(std::isnan(expected.psnr_db));
      for (const int threads : {1, 3}) {
        const ImageScore got = pictures.by(*make(threads));
        if (!GetParam().is_gpu() && !GetParam().is_loop()) {
          EXPECT_EQ(got.psnr_db, expected.psnr_db);
          EXPECT_EQ(got.flip, expected.flip);
          if (width > 10) {
            EXPECT_EQ(got.ssim, expected.ssim);
          }
          continue;
        }
        EXPECT_NEAR(got.psnr_db, expected.psnr_db, 1e-9);  // sums in another order
        if (width > 10) {
          EXPECT_NEAR(got.ssim, expected.ssim, kSsimRoundoff);
        }
        // Two sums of 21 terms, of which the oracle's are fused: 42 u of a luminance of 1, of which
        // L* has up to 903 in the dark. Of a colour difference of 1 and more, the 0.7th power times
        // 0.95 / 16.51 has up to 0.04 a unit.
        EXPECT_NEAR(got.flip, expected.flip, 42 * kFp32Roundoff * 903 * 0.04);
      }
    }
}

// As the figures of docs/benchmarks.md were made. FLIP's sums of 21 terms are fused by some
// backends and not by others: here some 1e-8.
TEST_P(ImageScoreStages, MatchesRecordedScores) {
  const auto backend = make();
  Pictures pictures = noisy_pictures(97, 75);
  const ImageScore all = pictures.by(*backend);
  EXPECT_NEAR(all.psnr_db, 18.234837751777189, 1e-9);
  EXPECT_NEAR(all.ssim, 0.88233605215964772, 1e-9);
  EXPECT_NEAR(all.flip, 0.25442253651159041, 1e-6);
  mask_some(&pictures);
  const ImageScore masked = pictures.by(*backend);
  EXPECT_NEAR(masked.psnr_db, 18.225782435166757, 1e-9);
  EXPECT_NEAR(masked.ssim, 0.90952571984786368, 1e-9);
  EXPECT_NEAR(masked.flip, 0.25127490627456062, 1e-6);
}

}  // namespace
}  // namespace redrive::kernels::conformance
