// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_scan.h"

#include <limits>
#include <numbers>

#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::kitti_scan;

constexpr kitti::ScanTime kRevolution{1'000'000'000, 1'100'000'000};

std::vector<LidarPoint> parsed_scan(const std::string& bytes) {
  return kitti::parse_scan(bytes, "velodyne_points/data/7.bin",
                           Rigid3d(Eigen::Translation3d(1, 0, 2)), kRevolution);
}

// Clockwise from above: left behind, left, ahead, right, right behind.
TEST(KittiScan, PointsHaveTheTimeOfTheirAzimuth) {
  const std::vector<LidarPoint> points = parsed_scan(kitti_scan(
      {{-10, -0.01f, 0, 0}, {0, -10, 0, 0.2f}, {10, 0, 1, 1}, {0, 10, 0, 0}, {-10, 0.01f, 0, 0}}));
  ASSERT_EQ(points.size(), 5u);
  const float x[] = {-9, 1, 11, 1, -9}, y[] = {0.01f, 10, 0, -10, -0.01f};
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_FLOAT_EQ(points[i].in_body_m.x(), x[i]) << i;
    EXPECT_FLOAT_EQ(points[i].in_body_m.y(), y[i]) << i;
    // Half a column of 100 ms / 2048, and the azimuth of 1 mrad behind.
    EXPECT_NEAR(static_cast<double>(points[i].t_ns), 1e9 + 25e6 * static_cast<double>(i), 41e3)
        << i;
    EXPECT_GE(points[i].t_ns, kRevolution.start_ns);
    EXPECT_LE(points[i].t_ns, kRevolution.end_ns);
  }
  EXPECT_FLOAT_EQ(points[2].in_body_m.z(), 3);
  EXPECT_EQ(points[2].intensity, 65535);
  EXPECT_EQ(points[3].intensity, 13107);
  EXPECT_EQ(kitti::time_of_direction(kRevolution, {5, 0, 0}), 1'050'000'000);
  EXPECT_EQ(kitti::time_of_direction(kRevolution, {0, 5, 1}), 1'025'000'000);
}

TEST(KittiScan, CompensatedPointsHaveOneTime) {
  const std::vector<LidarPoint> points = kitti::parse_scan(
      kitti_scan({{0, -10, 0, 0}, {0, 10, 0, 0}}), "0.bin", Rigid3d::Identity(), {7, 7});
  for (const LidarPoint& point : points) EXPECT_EQ(point.t_ns, 7);
}

TEST(KittiScan, RejectsInvalidValues) {
  const auto message = [](const std::string& bytes) {
    const std::string message = input_error([&] { parsed_scan(bytes); });
    EXPECT_THAT(message, HasSubstr("velodyne_points/data/7.bin: "));
    return message;
  };
  EXPECT_TRUE(parsed_scan("").empty());
  const std::string whole = kitti_scan({{1, 2, 3, 0.5f}, {4, 5, 6, 0.5f}});
  EXPECT_THAT(message(whole.substr(0, 31)),
              AllOf(HasSubstr("size = 31 bytes"), HasSubstr("multiple of 16")));
  EXPECT_THAT(message(std::string(16 * 4'000'001, '\0')), HasSubstr("number of points = 4000001"));
  EXPECT_THAT(message(kitti_scan({{1001, 2, 3, 0}})), HasSubstr("point 0 x = 1001"));
  EXPECT_THAT(message(kitti_scan({{1, 2, -2e9f, 0}})), HasSubstr("point 0 z = -2000000000"));
  EXPECT_THAT(message(kitti_scan({{1, 2, 3, 1.5f}})), HasSubstr("point 0 reflectance = 1.5"));
}

TEST(KittiScan, ReturnsThatCannotBeUsedAreLeftOutAndCounted) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::vector<std::array<float, 4>> points(40, {5, 0, 0, 0.5f});
  points[3] = {4, nan, 6, 0};
  points[7] = {0, 0, 0, 0};  // a direction without a return
  points[9] = {1, 2, 3, nan};
  points[11] = {-std::numeric_limits<float>::infinity(), 0, 0, 0};
  points[20] = {4000, 0, 0, 0.5f};
  points[21] = {5, 0, 0, 2};
  std::size_t left_out = 0;
  EXPECT_EQ(
      kitti::parse_scan(kitti_scan(points), "7.bin", Rigid3d::Identity(), kRevolution, &left_out)
          .size(),
      34u);
  EXPECT_EQ(left_out, 6u);
  points[22] = {5, 0, 0, 2};  // more than a twentieth: another unit
  EXPECT_THAT(input_error([&] { parsed_scan(kitti_scan(points)); }),
              HasSubstr("point 20 x = 4000"));
  std::ranges::fill(points, std::array<float, 4>{nan, nan, nan, nan});
  EXPECT_TRUE(parsed_scan(kitti_scan(points)).empty());
}

}  // namespace
}  // namespace redrive
