// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/cpu/cpu_raster.h"

#include <cmath>
#include <span>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/camera/camera.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/kernels/backend.h"
#include "redrive/math/rigid3.h"

namespace redrive::kernels {
namespace {

// Gaussians that each cover all 65,536 tiles make more pairs than 32 bits count: an error before
// memory is taken for them.
TEST(CpuRaster, MorePairsThanAreCountedAreAnError) {
  if (!best_isa()) GTEST_SKIP() << "the processor lacks AVX2";
  constexpr int kSide = 4096;
  constexpr std::size_t kGaussians = 65'600;
  std::vector<float> numbers(gaussian_blocks(kGaussians) * kBlockSize);
  for (std::size_t i = 0; i < kGaussians; ++i) {
    numbers[gaussian_slot(i, kPositionRow + 2)] = 1;
    numbers[gaussian_slot(i, kLogScaleRow + 2)] = std::log(0.01f);  // a disc of 1 m
    numbers[gaussian_slot(i, kQuaternionRow)] = 1;
    numbers[gaussian_slot(i, kOpacityRow)] = 3;
  }
  const Camera camera = make_camera(
      {"CAM", "opencv_pinhole", {kSide, kSide, kSide / 2, kSide / 2, 0, 0, 0, 0, 0}, kSide, kSide});
  const std::vector<PlainPose> poses = {plain(Rigid3d::Identity())};
  const auto backend = make_cpu_backend(*best_isa(), 2);
  const auto rasterise = [&](std::size_t n) {
    return backend->gaussians()
        .rasterise({make_plain_camera(camera), poses, 0, kSide, {}},
                   {n, std::span(numbers).first(gaussian_blocks(n) * kBlockSize)}, {})
        .counts()
        .pairs;
  };
  EXPECT_EQ(rasterise(16), 16u * 65'536) << "each covers the image";
  EXPECT_THROW(rasterise(kGaussians), std::logic_error);
}

}  // namespace
}  // namespace redrive::kernels
