// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/shading.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr ShadingConfig kConfig{2, 5, 3};

std::vector<float> parameters() {
  std::vector<float> p(kConfig.size());
  for (std::size_t i = 0; i < p.size(); ++i)
    p[i] = 2 * random_unit(random_key(8, kStreamTest, 2), i) - 1;
  return p;
}

/// Gains of the pixels [first, first + n) of row y of an image of width x height.
std::vector<float> gains(const std::vector<float>& p, int camera, int c, int width, int height,
                         int y, int first, int n) {
  std::vector<float> row(n, 1.0f);
  apply_shading(kConfig, p, camera, c, {(y + 0.5f) / height, (first + 0.5f) / width, 1.0f / width},
                row);
  return row;
}

float cell(const std::vector<float>& p, int camera, int c, int row, int column) {
  return std::exp(p[((3 * camera + c) * kConfig.rows + row) * kConfig.columns + column]);
}

TEST(Shading, GainsAreOneWithoutACameraAndForZeroParameters) {
  for (const float gain : gains(parameters(), -1, 0, 40, 30, 7, 0, 40)) EXPECT_EQ(gain, 1);
  for (const float gain : gains(std::vector<float>(kConfig.size()), 1, 2, 40, 30, 7, 0, 40))
    EXPECT_EQ(gain, 1);
}

TEST(Shading, IsOfItsCellAtCentresBilinearBetweenAndConstantBeyond) {
  const std::vector<float> p = parameters();
  // Cells of 7 x 5 pixels, whose centres are pixels' centres.
  for (int camera = 0; camera < 2; ++camera)
    for (int c = 0; c < 3; ++c)
      for (int row = 0; row < 3; ++row) {
        const std::vector<float> centres = gains(p, camera, c, 35, 15, 5 * row + 2, 0, 35);
        for (int column = 0; column < 5; ++column)
          EXPECT_NEAR(centres[7 * column + 3], cell(p, camera, c, row, column), 1e-5);
        EXPECT_NEAR(centres[0], centres[3], 1e-5);
        EXPECT_NEAR(centres[34], centres[31], 1e-5);
        EXPECT_NEAR(centres[5], (5 * centres[3] + 2 * centres[10]) / 7, 1e-5);
        if (row == 2) continue;
        const std::vector<float> below = gains(p, camera, c, 35, 15, 5 * row + 7, 0, 35),
                                 between = gains(p, camera, c, 35, 15, 5 * row + 3, 0, 35);
        for (int x = 0; x < 35; ++x)
          EXPECT_NEAR(between[x], 0.8f * centres[x] + 0.2f * below[x], 1e-5);
      }
}

TEST(Shading, OfAWindowIsThatOfTheImage) {
  const std::vector<float> p = parameters();
  const std::vector<float> whole = gains(p, 1, 1, 93, 40, 21, 0, 93),
                           window = gains(p, 1, 1, 93, 40, 21, 17, 60);
  for (int x = 0; x < 60; ++x) EXPECT_NEAR(window[x], whole[x + 17], 1e-5);
}

}  // namespace
}  // namespace redrive
