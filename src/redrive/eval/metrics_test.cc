// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/metrics.h"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

std::vector<float> constant(int width, int height, float value) {
  return std::vector<float>(3 * width * height, value);
}

std::vector<float> noise(int width, int height, std::uint64_t stream) {
  std::vector<float> image(3 * width * height);
  for (std::size_t i = 0; i < image.size(); ++i) image[i] = random_unit(random_key(1, kStreamTest, stream), i);
  return image;
}

TEST(Psnr, IsTenLogOfTheInverseMeanSquare) {
  EXPECT_DOUBLE_EQ(psnr_db(constant(4, 3, 0.75f), constant(4, 3, 0.25f), {}, 4, 3), 10 * std::log10(4.0));
  // One of 12 x 3 values off by 1: MSE = 1/36.
  std::vector<float> one = constant(4, 3, 0);
  one[17] = 1;
  EXPECT_DOUBLE_EQ(psnr_db(one, constant(4, 3, 0), {}, 4, 3), 10 * std::log10(36.0));
  EXPECT_EQ(psnr_db(one, one, {}, 4, 3), std::numeric_limits<double>::infinity());
}

TEST(Psnr, MaskLeavesPixelsOut) {
  std::vector<float> image = constant(4, 3, 0);
  image[3 * 5] = 1;  // one channel of pixel 5
  std::vector<std::uint8_t> mask(12, 1);
  mask[0] = mask[1] = 0;
  EXPECT_DOUBLE_EQ(psnr_db(image, constant(4, 3, 0), mask, 4, 3), 10 * std::log10(30.0));  // 10 pixels
  mask[5] = 0;
  EXPECT_EQ(psnr_db(image, constant(4, 3, 0), mask, 4, 3), std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::isnan(psnr_db(image, image, std::vector<std::uint8_t>(12, 0), 4, 3)));
}

TEST(Ssim, EqualImagesAreOne) {
  const std::vector<float> image = noise(23, 17, 0);
  EXPECT_NEAR(ssim(image, image, {}, 23, 17), 1, 1e-15);
}

TEST(Ssim, ConstantImagesFollowTheClosedForm) {
  const double a = 0.75, b = 0.25, c1 = 1e-4;
  // Variances are differences of sums of 121 products below 1: 121 x 2.2e-16, against C2 = 9e-4.
  EXPECT_NEAR(ssim(constant(20, 15, 0.75f), constant(20, 15, 0.25f), {}, 20, 15),
              (2 * a * b + c1) / (a * a + b * b + c1), 121 * 2.3e-16 / 9e-4);
}

TEST(Ssim, IsSymmetric) {
  EXPECT_DOUBLE_EQ(ssim(noise(19, 21, 0), noise(19, 21, 1), {}, 19, 21),
                   ssim(noise(19, 21, 1), noise(19, 21, 0), {}, 19, 21));
}

/// Straight from the definition: every window on its own, variances as means of squared deviations.
double brute_force(const std::vector<float>& x, const std::vector<float>& y, int width, int height) {
  double sum = 0;
  int windows = 0;
  for (int channel = 0; channel < 3; ++channel)
    for (int row = 5; row < height - 5; ++row)
      for (int column = 5; column < width - 5; ++column, ++windows) {
        double total = 0, mx = 0, my = 0, vx = 0, vy = 0, cov = 0;
        const auto walk = [&](auto&& visit) {
          for (int dy = -5; dy <= 5; ++dy)
            for (int dx = -5; dx <= 5; ++dx) {
              const int i = 3 * ((row + dy) * width + column + dx) + channel;
              visit(std::exp(-(dx * dx + dy * dy) / (2 * 1.5 * 1.5)), x[i], y[i]);
            }
        };
        walk([&](double w, double, double) { total += w; });
        walk([&](double w, double a, double b) { mx += w / total * a, my += w / total * b; });
        walk([&](double w, double a, double b) {
          vx += w / total * (a - mx) * (a - mx);
          vy += w / total * (b - my) * (b - my);
          cov += w / total * (a - mx) * (b - my);
        });
        sum += (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
      }
  return sum / windows;
}

TEST(Ssim, AgreesWithEveryWindowOnItsOwn) {
  const int width = 31, height = 24;
  std::vector<float> x = noise(width, height, 0), y = noise(width, height, 1);
  for (std::size_t i = 0; i < y.size(); ++i) y[i] = 0.7f * x[i] + 0.3f * y[i];  // correlated
  const double expected = brute_force(x, y, width, height);
  EXPECT_GT(expected, 0.5);
  EXPECT_LT(expected, 0.99);
  EXPECT_NEAR(ssim(x, y, {}, width, height), expected, 4 * 121 * 2.3e-16 / 9e-4);
}

TEST(Ssim, MaskedWindowsDoNotCountAndMaskedPixelsAreEqual) {
  const int width = 40, height = 12;  // windows in rows 5 and 6, columns 5..34
  std::vector<float> x = noise(width, height, 0), y = x;
  std::vector<std::uint8_t> mask(width * height, 1);
  for (int row = 0; row < height; ++row)
    for (int column = 20; column < width; ++column) {
      mask[row * width + column] = 0;
      for (int c = 0; c < 3; ++c) y[3 * (row * width + column) + c] = 0.5f;  // wrong, but masked
    }
  EXPECT_NEAR(ssim(x, y, mask, width, height), 1, 1e-15);
  EXPECT_LT(ssim(x, y, {}, width, height), 0.9);
  EXPECT_TRUE(std::isnan(ssim(x, y, std::vector<std::uint8_t>(width * height, 0), width, height)));
}

TEST(Ssim, NothingToSayBelowElevenPixels) {
  EXPECT_TRUE(std::isnan(ssim(constant(10, 30, 0), constant(10, 30, 0), {}, 10, 30)));
}

}  // namespace
}  // namespace redrive
