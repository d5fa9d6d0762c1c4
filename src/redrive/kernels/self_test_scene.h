// SPDX-License-Identifier: Apache-2.0
// What the self-test of a device draws.
#pragma once

#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// Gaussians in front of a camera of 70 x 43 pixels.
struct SelfTestScene {
  static constexpr std::size_t kCount = 203;  // no multiple of a block
  PlainCamera camera;
  std::array<PlainPose, 1> pose{};
  std::vector<float> numbers;  ///< Gaussians::numbers

  SelfTestScene() : numbers(gaussian_blocks(kCount) * kBlockSize) {
    camera.fx = camera.fy = 60;
    camera.cx = 34.5f;
    camera.cy = 21;
    camera.width = 70;
    camera.height = 43;
    std::mt19937 random(5);
    for (std::size_t i = 0; i < kCount; ++i) {
      const auto number = [&](int row) -> float& { return numbers[gaussian_slot(i, row)]; };
      for (int row = 0; row < kGaussianRows; ++row) number(row) = next(&random);
      number(kPositionRow) *= 2;
      number(kPositionRow + 2) += 4;
      for (int k = 0; k < 3; ++k) number(kLogScaleRow + k) -= 1.5f;
      number(kDistanceRow) = 4;
    }
  }
  /// Returns a number in [-1, 1).
  static float next(std::mt19937* random) {
    return std::ldexp(static_cast<float>((*random)() >> 8), -23) - 1;
  }
  GaussianCamera view() const {
    return {.camera = camera, .world_from_camera = pose, .image_rows = float(camera.height)};
  }
  RasterSize size() const { return raster_size(camera.width, camera.height); }
};

}  // namespace redrive::kernels
