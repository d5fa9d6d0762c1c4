// SPDX-License-Identifier: Apache-2.0
#include "redrive/volume/blend_gaussians.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr int kNumbers = 10;  // numbers of a splat
constexpr int kSplats = 3;
using Jet = ceres::Jet<double, kNumbers * kSplats>;
constexpr float kBackground[3] = {0.2f, 0.5f, 0.9f};
constexpr double kX = 3, kY = 5, kLogRange = 1.0, kRangeWeight = 0.7;
constexpr double kRgbWeights[3] = {0.4, -1.1, 0.6};

std::vector<Splat2d<double>> splats() {
  return {{{2.5, 4.8}, {0.4, 0.1, 0.3}, 0.6, {0.9, 0.2, 0.1}, 2.0},
          {{3.2, 5.5}, {0.8, -0.2, 0.5}, 0.999, {0.1, 0.8, 0.3}, 2.5},
          {{40, 5}, {0.3, 0, 0.3}, 0.9, {1, 1, 1}, 3.0}};  // not in this pixel
}

TEST(BlendGaussiansTest, OneOpaqueSplatHidesTheBackground) {
  std::vector<Splat2d<double>> one = splats();
  one.resize(1);
  one[0].mean[0] = kX;
  one[0].mean[1] = kY;
  one[0].alpha = 1;
  const BlendedPixel<double> pixel = blend_gaussians(one, kX, kY, kBackground, kLogRange);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(pixel.rgb[c], 0.99 * one[0].rgb[c] + 0.01 * double(kBackground[c]), 1e-7);
  EXPECT_EQ(pixel.depth, 2);
}

TEST(BlendGaussiansTest, AdjointAgreesWithAutomaticDifferentiation) {
  const std::vector<Splat2d<double>> all = splats();
  std::vector<Splat2d<Jet>> jets(kSplats);
  for (int i = 0; i < kSplats; ++i) {
    int next = kNumbers * i;
    const auto jet = [&](double value) { return Jet(value, next++); };
    for (int k = 0; k < 2; ++k) jets[i].mean[k] = jet(all[i].mean[k]);
    for (int k = 0; k < 3; ++k) jets[i].conic[k] = jet(all[i].conic[k]);
    jets[i].alpha = jet(all[i].alpha);
    for (int k = 0; k < 3; ++k) jets[i].rgb[k] = jet(all[i].rgb[k]);
    jets[i].distance = jet(all[i].distance);
  }
  const BlendedPixel<Jet> pixel = blend_gaussians(jets, kX, kY, kBackground, kLogRange);
  constexpr double kTransmittanceWeight = 0.7;
  Jet loss = kRangeWeight * pixel.range_error + kTransmittanceWeight * pixel.transmittance;
  for (int c = 0; c < 3; ++c) loss += kRgbWeights[c] * pixel.rgb[c];

  std::vector<Splat2dGradient> d(kSplats);
  blend_gaussians_adjoint(all, kX, kY, kBackground, kLogRange,
                          {kRgbWeights, kRangeWeight, kTransmittanceWeight}, 0.5, &d);
  for (int i = 0; i < kSplats; ++i) {
    const double found[kNumbers] = {d[i].mean[0],  d[i].mean[1],  d[i].conic[0],
                                    d[i].conic[1], d[i].conic[2], d[i].log_alpha / all[i].alpha,
                                    d[i].rgb[0],   d[i].rgb[1],   d[i].rgb[2],
                                    d[i].distance};
    for (int k = 0; k < kNumbers; ++k)
      EXPECT_NEAR(found[k], loss.v[kNumbers * i + k], 1e-9) << i << ", " << k;
  }
  EXPECT_GT(d[0].error, 0);
  EXPECT_EQ(d[2].error, 0);
}

TEST(BlendGaussiansTest, PartsHaveTheWeightsOfTheirGaussians) {
  // At their means: world 0.4, part 1 0.5, part 2 0.8, part 1 0.6.
  const auto splat = [](double alpha) {
    return Splat2d<double>{{3, 4}, {1, 0, 1}, alpha, {0, 0, 0}, 1};
  };
  const std::vector<Splat2d<double>> splats{splat(0.4), splat(0.5), splat(0.8), splat(0.6)};
  const PartWeights weights = blend_parts(splats, {0, 1, 2, 1}, 4, 3, 4);
  const double background = 0.6 * 0.5 * 0.2 * 0.4;
  const std::vector<double> visible{0.4 + background, 0.6 * 0.5 + 0.6 * 0.5 * 0.2 * 0.6,
                                    0.6 * 0.5 * 0.8, 0},
      alone{0.4, 1 - 0.5 * 0.4, 0.8, 0};
  for (int part = 0; part < 4; ++part) {
    EXPECT_NEAR(weights.visible[part], visible[part], 1e-12) << part;
    EXPECT_NEAR(weights.alone[part], alone[part], 1e-12) << part;
  }
}

}  // namespace
}  // namespace redrive
