// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/lidar_sensor.h"

#include <cmath>

#include <gmock/gmock.h>

namespace redrive {
namespace {

using ::testing::ElementsAre;

TEST(Beams, AreAListOrEvenlySpaced) {
  EXPECT_THAT(*parse_beams("3:-24:2"), ElementsAre(-24, -11, 2));
  EXPECT_THAT(*parse_beams("-1.5,0,7"), ElementsAre(-1.5, 0, 7));
  EXPECT_THAT(*parse_beams("5.0"), ElementsAre(5));
  EXPECT_THAT(*parse_beams("-5"), ElementsAre(-5));
  EXPECT_EQ(parse_beams("256:-90:90")->size(), 256u);
  for (const char* text :
       {"",      "a",       "1,",          ",1",      "3:-24",     "3:-24:2:1", "1",
        "0",     "257",     "99999999999", "1:-24:2", "2.5:-24:2", "257:-24:2", "3:2:-24",
        "3:2:2", "3:-91:2", "1,91",        "nan",     "1,inf",     "1 2",       "recorded"})
    EXPECT_FALSE(parse_beams(text)) << text;
}

TEST(Beams, AreAsUsualSensorsHaveThemWhereOnlyTheirNumberIsGiven) {
  EXPECT_EQ(parse_beams("64"), parse_beams("64:-24.8:2"));
  EXPECT_EQ(parse_beams("16"), parse_beams("16:-15:15"));
  EXPECT_EQ(parse_beams("32"), parse_beams("32:-30.67:10.67"));
  EXPECT_EQ(parse_beams("128"), parse_beams("128:-25:15"));
}

// Eight steps, clockwise from behind by the left: the frame's time is when the sensor looks ahead.
TEST(SpinningLidar, TurnsClockwiseAndLooksAheadAtTheFramesTime) {
  SpinningLidar lidar;
  lidar.elevation_deg = {-30, 0};
  lidar.azimuth_steps = 8;
  lidar.rate_hz = 20;
  const LidarFirings firings = lidar.revolution(1'000'000'000);
  ASSERT_EQ(firings.size(), 16u);
  ASSERT_EQ(firings.direction.size(), 16u);
  for (std::size_t i = 0; i < 16; ++i) {
    const int step = static_cast<int>(i / 2);
    EXPECT_EQ(firings.t_ns[i], 1'000'000'000 + (2 * step - 7) * 3'125'000) << "50 ms in 8 steps";
    EXPECT_NEAR(firings.direction[i].norm(), 1, 1e-15);
    EXPECT_NEAR(firings.direction[i].z(), i % 2 ? 0 : -0.5, 1e-15);
    const double azimuth_deg =
        std::atan2(firings.direction[i].y(), firings.direction[i].x()) * 180 / M_PI;
    EXPECT_NEAR(azimuth_deg, 157.5 - 45 * step, 1e-12);
  }
}

TEST(LidarAxes, AreThoseOfACameraThatLooksAhead) {
  EXPECT_TRUE(
      (Mount{}.body_from_sensor() * camera_from_lidar_axes()).isApprox(Rigid3d::Identity(), 1e-15));
  const Mount mount{{1, 2, 3}, /*yaw_deg=*/90, /*pitch_deg=*/0, /*roll_deg=*/0};
  EXPECT_LT(((mount.body_from_sensor() * camera_from_lidar_axes()) * Eigen::Vector3d(5, 0, 0) -
             Eigen::Vector3d(1, 7, 3))
                .norm(),
            1e-12)
      << "yaw to the left";
}

}  // namespace
}  // namespace redrive
