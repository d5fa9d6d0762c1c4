// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/scan_loss.h"

#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// An image of a tile. Of each four places two have a ray with a return, one a lost ray, one none.
struct Case {
  kernels::RasterImage image;
  ScanTarget target;
  ScanWeights weights{0.7f, 0.3f, 0.5f};
  std::size_t plane;

  Case() {
    image.size = kernels::raster_size(16, 16);
    plane = image.size.plane();
    image.rgb = Buffer<float>(3 * plane);
    image.transmittance = Buffer<float>(plane);
    image.range_error = Buffer<float>(plane);
    for (std::size_t i = 0; i < plane; ++i) {
      const auto part = [&](int k) {
        return 0.5f + 0.4f * std::sin(static_cast<float>(7 * i + 13 * std::size_t(k)));
      };
      image.rgb[kIntensitySlot * plane + i] = part(0);
      image.rgb[kReturnSlot * plane + i] = part(1);
      image.transmittance[i] = part(2);
      image.range_error[i] = 0.1f * part(3);
      target.log_range.push_back(i % 4 < 2 ? 1 + part(4) : kernels::kNoRange);
      target.intensity.push_back(i % 4 < 2 ? part(5) : 0);
      target.weight.push_back(i % 4 < 3 ? 0.01f : 0);
    }
  }
  double loss() {
    ScanGradient gradient;
    return scan_loss(image, target, weights, &gradient);
  }
};

TEST(ScanLoss, GradientsAreThoseOfTheLoss) {
  Case c;
  ScanGradient gradient;
  scan_loss(c.image, c.target, c.weights, &gradient);
  const auto expect = [&](float* number, float derivative) {
    constexpr float kStep = 0.05f;
    const float was = *number;
    *number = was + kStep;
    const double above = c.loss();
    *number = was - kStep;
    const double below = c.loss();
    *number = was;
    EXPECT_NEAR(derivative, (above - below) / double(2 * kStep), 1e-6);
  };
  for (std::size_t i = 0; i < c.plane; ++i) {
    for (std::size_t slot = 0; slot < 3; ++slot)
      expect(&c.image.rgb[slot * c.plane + i], gradient.d_rgb[slot * c.plane + i]);
    expect(&c.image.transmittance[i], gradient.d_transmittance[i]);
    expect(&c.image.range_error[i], gradient.d_range[i]);
  }
}

TEST(ScanLoss, IsNothingWhereTheImageIsWhatWasMeasured) {
  Case c;
  for (std::size_t i = 0; i < c.plane; ++i) {
    const bool returned = c.target.log_range[i] != kernels::kNoRange;
    c.image.range_error[i] = 0;
    c.image.rgb[kReturnSlot * c.plane + i] = returned;
    c.image.rgb[kIntensitySlot * c.plane + i] =
        (1 - c.image.transmittance[i]) * c.target.intensity[i];
  }
  EXPECT_NEAR(c.loss(), 0, 1e-9);
}

}  // namespace
}  // namespace redrive
