// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/flip.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr int kFlipWidth = 48, kFlipHeight = 32;

std::vector<float> uniform(float r, float g, float b) {
  std::vector<float> image;
  for (int i = 0; i < kFlipWidth * kFlipHeight; ++i) image.insert(image.end(), {r, g, b});
  return image;
}

double flip_of(const std::vector<float>& a, const std::vector<float>& b, std::span<const std::uint8_t> mask = {}) {
  return flip(a, b, mask, kFlipWidth, kFlipHeight);
}

TEST(Flip, EqualPicturesDoNotDiffer) { EXPECT_EQ(flip_of(uniform(0.3f, 0.5f, 0.7f), uniform(0.3f, 0.5f, 0.7f)), 0); }

// Uniform pictures have no features, so only colour counts, and filters leave it as it is.
// L*a*b* (D65): green 87.735, -86.183, 83.179; blue 32.297, 79.188, -107.860. With chroma times L / 100 their HyAB distance is
// 55.438 + |(-75.612 - 25.575, 72.977 + 34.836)| = 203.30; to the power of 0.7, 41.28: the largest difference.
// Black and white: 100^0.7 = 25.119, beyond the knee at 0.4 * 41.28 = 16.51: 0.95 + 0.05 (25.119 - 16.51) / (41.28 - 16.51).
TEST(Flip, UniformPicturesByHand) {
  EXPECT_NEAR(flip_of(uniform(0, 0, 0), uniform(1, 1, 1)), 0.9674, 2e-4);
  EXPECT_NEAR(flip_of(uniform(0, 1, 0), uniform(0, 0, 1)), 1, 1e-5);
  // sRGB 0.5 and 0.6 are linear 0.21404 and 0.31855: L* 53.389 and 63.223; 9.834^0.7 = 4.952, times 0.95 / 16.51.
  EXPECT_NEAR(flip_of(uniform(0.5f, 0.5f, 0.5f), uniform(0.6f, 0.6f, 0.6f)), 0.2849, 5e-4);
}

TEST(Flip, IsSymmetricAndBounded) {
  std::vector<float> a = uniform(0.5f, 0.5f, 0.5f), b = a;
  for (std::size_t i = 0; i < a.size(); ++i)
    a[i] = static_cast<float>(i * 7919 % 101) / 100, b[i] = static_cast<float>(i * 104729 % 97) / 96;
  const double ab = flip_of(a, b);
  EXPECT_NEAR(ab, flip_of(b, a), 1e-7);
  EXPECT_GT(ab, 0.1);
  EXPECT_LT(ab, 1);
}

/// Squares of `size` pixels, black and white.
std::vector<float> checkerboard(int size) {
  std::vector<float> image;
  for (int y = 0; y < kFlipHeight; ++y)
    for (int x = 0; x < kFlipWidth; ++x) image.insert(image.end(), 3, static_cast<float>((x / size + y / size) % 2));
  return image;
}

// Light adds linearly: from afar a checkerboard is the grey of linear 0.5, sRGB 0.7354. Single pixels (67 of them make a
// degree) are beyond what the eye resolves, squares of 16 are not.
TEST(Flip, WhatTheEyeCannotResolveHardlyCounts) {
  const std::vector<float> grey = uniform(0.7354f, 0.7354f, 0.7354f);
  EXPECT_LT(flip_of(checkerboard(1), grey), 0.2);
  EXPECT_GT(flip_of(checkerboard(16), grey), 0.7);
}

TEST(Flip, MaskedPixelsDoNotCount) {
  std::vector<float> a = uniform(0.2f, 0.4f, 0.6f), b = a;
  std::vector<std::uint8_t> mask(kFlipWidth * kFlipHeight, 1);
  for (int x = 0; x < kFlipWidth; ++x) {
    mask[x] = 0;
    for (int c = 0; c < 3; ++c) b[3 * x + c] = 1;
  }
  EXPECT_GT(flip_of(a, b), 0);
  EXPECT_EQ(flip_of(a, b, mask), 0);
  EXPECT_TRUE(std::isnan(flip_of(a, b, std::vector<std::uint8_t>(kFlipWidth * kFlipHeight, 0))));
}

}  // namespace
}  // namespace redrive
