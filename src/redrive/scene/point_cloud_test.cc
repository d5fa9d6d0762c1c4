// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/point_cloud.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "redrive/camera/camera.h"

namespace redrive {
namespace {

TEST(PixelIndex, IsThePixelWhoseMiddleIsNearest) {
  EXPECT_EQ(pixel_index(10, 8, {-0.5, -0.5}), 0u);
  EXPECT_EQ(pixel_index(10, 8, {3.4, 2.6}), 33u);
  EXPECT_EQ(pixel_index(10, 8, {9.49, 7.49}), 79u);
  EXPECT_FALSE(pixel_index(10, 8, {9.5, 7}));
  EXPECT_FALSE(pixel_index(10, 8, {-0.51, 7}));
}

// A pinhole without distortion has no edge: points nearly beside it have any coordinates.
TEST(PixelIndex, HasNoneForWhatNoIntegerHolds) {
  const Camera camera =
      make_camera({"PINHOLE", "opencv_pinhole", {5, 5, 4.5, 3.5, 0, 0, 0, 0, 0}, 10, 8});
  for (const double ahead : {1e-9, 1e-30, 1e-300}) {
    const auto pixel = camera.project({1, 0, ahead});
    ASSERT_TRUE(pixel);
    EXPECT_FALSE(pixel_index(camera.width, camera.height, *pixel)) << ahead;
  }
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  for (const double beyond :
       {0x1p32 + 5, -0x1p32 + 5, 0x1p64 + 0x1p13, 1e300, kInfinity, -kInfinity, std::nan("")}) {
    EXPECT_FALSE(pixel_index(10, 8, {beyond, 5})) << beyond;
    EXPECT_FALSE(pixel_index(10, 8, {5, beyond})) << beyond;
  }
}

}  // namespace
}  // namespace redrive
