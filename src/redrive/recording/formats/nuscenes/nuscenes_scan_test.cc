// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "redrive/recording/formats/nuscenes/nuscenes_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

constexpr std::int64_t kEnd_ns = 1'000'000'000, kColumn_ns = 46'080;

/// A body at 10 m/s along x, at 10 m at the end of the revolution.
std::vector<FramePose> driving() {
  return {{0, 0, Rigid3d(Eigen::Translation3d(0, 0, 0))},
          {1, kEnd_ns, Rigid3d(Eigen::Translation3d(10, 0, 0))}};
}

std::string nuscenes_scan(const std::vector<std::array<float, 5>>& points) {
  return {reinterpret_cast<const char*>(points.data()), points.size() * sizeof points[0]};
}

std::vector<LidarPoint> parsed(const std::string& bytes) {
  return nuscenes::parse_scan(bytes, "LIDAR_TOP/7.pcd.bin",
                              {Rigid3d(Eigen::Translation3d(1, 0, 2)), kEnd_ns}, driving());
}

// All columns have the same point of the world. The body was behind its position at the end by 10
// m/s for the time that a column is earlier, so the point was further ahead of it.
TEST(NuScenesScan, PointsAreInTheBodyAtTheirOwnTime) {
  std::vector<std::array<float, 5>> points;
  for (int column = 0; column < 1085; ++column)
    for (int ring = 0; ring < 32; ++ring)
      points.push_back({20, 3, -1, 17.4f, static_cast<float>(ring)});
  const std::vector<LidarPoint> scan = parsed(nuscenes_scan(points));
  ASSERT_EQ(scan.size(), points.size());
  for (std::size_t i = 0; i < scan.size(); ++i) {
    const std::int64_t before_ns = kColumn_ns * static_cast<std::int64_t>(1084 - i / 32);
    ASSERT_EQ(scan[i].t_ns, kEnd_ns - before_ns);
    // Floats step by 2e-6 at 21.
    ASSERT_NEAR(scan[i].in_body_m.x(), 21 + 1e-8 * static_cast<double>(before_ns), 4e-6);
    ASSERT_FLOAT_EQ(scan[i].in_body_m.y(), 3);
    ASSERT_FLOAT_EQ(scan[i].in_body_m.z(), 1);
  }
  EXPECT_EQ(scan[0].intensity, 17);
}

// A file without its points near the car still has the beginnings of its columns.
TEST(NuScenesScan, AColumnBeginsWhereTheRingDoesNotIncrease) {
  const std::vector<LidarPoint> scan = parsed(nuscenes_scan(
      {{9, 0, 0, -95, 4}, {9, 0, 0, 300, 9}, {9, 0, 0, 0, 9}, {9, 0, 0, 0, 2}, {9, 0, 0, 0, 31}}));
  const int column[] = {0, 0, 1, 2, 2};
  for (std::size_t i = 0; i < 5; ++i)
    EXPECT_EQ(scan[i].t_ns, kEnd_ns - kColumn_ns * (2 - column[i])) << i;
  EXPECT_EQ(scan[0].intensity, 0);
  EXPECT_EQ(scan[1].intensity, 255);
  EXPECT_TRUE(parsed("").empty());
}

TEST(NuScenesScan, RejectsInvalidValues) {
  const auto message = [](std::size_t field, float value) {
    std::array<float, 5> point = {1, 2, 3, 4, 5};
    point[field] = value;
    return input_error([&] { parsed(nuscenes_scan({{0, 0, 0, 0, 0}, point})); });
  };
  EXPECT_THAT(input_error([] { parsed(std::string(41, '\0')); }),
              AllOf(HasSubstr("7.pcd.bin: size = 41 bytes"), HasSubstr("multiple of 20")));
  EXPECT_THAT(message(2, -1001), HasSubstr("point 1 z = -1001"));
  for (const float ring : {-1.0f, 255.0f, 0.5f, std::numeric_limits<float>::quiet_NaN()})
    EXPECT_THAT(message(4, ring), HasSubstr("point 1 ring")) << ring;
}

TEST(NuScenesScan, ReturnsThatCannotBeUsedAreLeftOutAndCounted) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::vector<std::array<float, 5>> points(40, {9, 0, 0, 1, 31});
  points[3][0] = nan;
  points[4] = {0, 0, 0, 0, 31};
  points[5][3] = std::numeric_limits<float>::infinity();
  points[6][4] = 255;
  points[39][2] = 2000;
  std::size_t left_out = 0;
  const auto scan =
      nuscenes::parse_scan(nuscenes_scan(points), "7.pcd.bin", {Rigid3d::Identity(), kEnd_ns},
                           {{0, 0, Rigid3d::Identity()}}, &left_out);
  EXPECT_EQ(scan.size(), 35u);
  EXPECT_EQ(left_out, 5u);
  EXPECT_EQ(scan[3].t_ns - scan[2].t_ns, 4 * kColumn_ns);  // what is left out keeps its column
  points[7][4] = nan;
  EXPECT_THAT(input_error([&] { parsed(nuscenes_scan(points)); }), HasSubstr("point 6 ring"));
}

/// Sixty-four lasers in `columns` that turn counterclockwise from -y in the sensor's axes.
std::vector<std::array<float, 5>> other_sensor(int columns) {
  std::vector<std::array<float, 5>> points;
  for (int c = 0; c < columns; ++c)
    for (int ring = 0; ring < 64; ++ring) {
      const double azimuth = 2 * M_PI * c / columns - M_PI / 2;
      points.push_back({static_cast<float>(20 * std::cos(azimuth)),
                        static_cast<float>(20 * std::sin(azimuth)), -1, 17,
                        static_cast<float>(ring)});
    }
  return points;
}

TEST(NuScenesScan, ColumnsOfOtherSensorsFillTheRevolution) {
  constexpr std::int64_t kTurn_ns = 100'000'000;
  const std::string bytes = nuscenes_scan(other_sensor(2000));
  const nuscenes::Spin spin = nuscenes::spin_of(bytes, "7.pcd.bin", kTurn_ns);
  const auto scan =
      nuscenes::parse_scan(bytes, "7.pcd.bin", {Rigid3d::Identity(), kEnd_ns, spin}, driving());
  ASSERT_EQ(scan.size(), 2000u * 64);
  for (std::size_t i = 0; i < scan.size(); i += 63)
    ASSERT_EQ(scan[i].t_ns, kEnd_ns - 50'000 * static_cast<std::int64_t>(1999 - i / 64));
  for (const double part : {0.1, 0.45, 0.8}) {
    const double azimuth = 2 * M_PI * part - M_PI / 2;
    EXPECT_NEAR(double(spin.time_of({std::cos(azimuth), std::sin(azimuth), 0}, kEnd_ns)),
                double(kEnd_ns) - (1 - part) * kTurn_ns, 1e5);
  }
}

TEST(NuScenesScan, TheSpinOfTheHdl32eIsKnownAndOfUnorderedScansIsNot) {
  std::vector<std::array<float, 5>> points = other_sensor(1000), every_second;
  for (std::size_t i = 0; i < points.size(); i += 2) {
    every_second.push_back(points[i]);
    every_second.back()[4] /= 2;
  }
  const nuscenes::Spin own = nuscenes::spin_of(nuscenes_scan(every_second), "7.pcd.bin", 0);
  EXPECT_EQ(own.duration_ns, 50'000'000);
  EXPECT_EQ(own.time_of({1, 0, 0}, kEnd_ns), kEnd_ns - 25'000'000);  // to the right of the car
  std::shuffle(points.begin(), points.end(), std::mt19937(1));
  const nuscenes::Spin none = nuscenes::spin_of(nuscenes_scan(points), "7.pcd.bin", 1);
  EXPECT_EQ(none.turn_rad, 0);
  EXPECT_EQ(none.time_of({1, 0, 0}, kEnd_ns), kEnd_ns);
  for (const LidarPoint& point : nuscenes::parse_scan(
           nuscenes_scan(points), "7.pcd.bin", {Rigid3d::Identity(), kEnd_ns, none}, driving()))
    ASSERT_EQ(point.t_ns, kEnd_ns);
}

// The body drives at 10 m/s. A scan of two thirds of a turn, of whose points more are in its first
// half, so that their order does not tell their times.
TEST(NuScenesScan, WithoutRingsTimesAreThoseOfAzimuths) {
  constexpr std::int64_t kTaken_ns = 60'000'000;
  const Rigid3d body_from_lidar(Eigen::Translation3d(1, 0, 2));
  const Rigid3d lidar_from_global_at_end =
      (pose_at(driving(), kEnd_ns) * body_from_lidar).inverse();
  std::vector<std::array<float, 5>> points;
  std::vector<std::int64_t> times_ns;
  std::vector<Eigen::Vector3d> in_body_m;
  for (int i = 0; i < 4000; ++i) {
    const double part = i < 3000 ? i / 6000.0 : 0.5 + (i - 3000 + 1) / 2000.0;
    times_ns.push_back(kEnd_ns - std::llround((1 - part) * kTaken_ns));
    const double azimuth = 2.5 - part * 4 * M_PI / 3, range = 15 + i % 30;
    in_body_m.push_back(body_from_lidar *
                        Eigen::Vector3d(range * std::cos(azimuth), range * std::sin(azimuth), -1));
    const Eigen::Vector3d at =
        lidar_from_global_at_end * (pose_at(driving(), times_ns.back()) * in_body_m.back());
    points.push_back({float(at.x()), float(at.y()), float(at.z()), 9, 0});
  }
  const std::string bytes = nuscenes_scan(points);
  const nuscenes::Spin spin = nuscenes::spin_of(bytes, "7.pcd.bin", kTaken_ns);
  EXPECT_NEAR(spin.turn_rad, -4 * M_PI / 3, 0.05);
  const auto scan =
      nuscenes::parse_scan(bytes, "7.pcd.bin", {body_from_lidar, kEnd_ns, spin}, driving());
  ASSERT_EQ(scan.size(), points.size());
  double most_ns = 0;
  for (std::size_t i = 0; i < scan.size(); ++i)
    most_ns = std::max(most_ns, std::abs(double(scan[i].t_ns - times_ns[i])));
  EXPECT_LT(most_ns, 1.5e6) << "in the order of the file a point would be 15 ms off";
}

TEST(NuScenesScan, RingsThatAreAllZeroAreNotKnown) {
  const std::vector<LidarPoint> scan = parsed(nuscenes_scan({{9, 0, 0, 1, 0}, {8, 0, 0, 1, 0}}));
  EXPECT_EQ(scan[0].ring, kNoRing);
}

TEST(NuScenesScan, AScanIsReadBack) {
  LidarRecord point{{10, 3, -1}, 0, 0.2f};
  point.ring = 7;
  Rigid3d forward_from_lidar = Rigid3d::Identity();
  forward_from_lidar.linear() << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  const auto points = nuscenes::parse_scan(nuscenes::make_scan(std::vector{point}), "a.pcd.bin",
                                           {forward_from_lidar, kEnd_ns}, driving());
  ASSERT_EQ(points.size(), 1u);
  EXPECT_EQ(points[0].in_body_m, Eigen::Vector3f(10, 3, -1));
  EXPECT_EQ(points[0].intensity, 51);
  EXPECT_EQ(points[0].ring, 7);
}

}  // namespace
}  // namespace redrive
