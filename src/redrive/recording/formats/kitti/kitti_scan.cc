// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_scan.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/recording/lidar/unusable_returns.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::kitti {
namespace {

constexpr std::size_t kMaxScanPoints = 4'000'000;
constexpr float kMaxScanCoordinate_m = 1000;
constexpr auto kColumns = static_cast<double>(kScanColumns);

/// Turns from ahead to the left, -0.5 to 0.5.
double turns_to_left(double x, double y) { return std::atan2(y, x) / (2 * std::numbers::pi); }

/// 0 at the start of the revolution to 1 at its end.
double fraction_of_revolution(double x, double y) { return 0.5 - turns_to_left(x, y); }

/// 0 ahead, growing to the left, to 1 ahead again.
double fraction_of_turn(double x, double y) {
  const double turn = turns_to_left(x, y);
  return turn < 0 ? turn + 1 : turn;
}

std::int64_t time_at(const ScanTime& time, double fraction) {
  return time.start_ns + std::llround(fraction * static_cast<double>(time.end_ns - time.start_ns));
}

}  // namespace

std::int64_t time_of_direction(const ScanTime& time, const Eigen::Vector3d& in_velodyne) {
  return time_at(time, fraction_of_revolution(in_velodyne.x(), in_velodyne.y()));
}

std::int64_t time_of_point(const ScanTime& time, double x, double y) {
  const double column = std::min(std::floor(kColumns * fraction_of_revolution(x, y)), kColumns - 1);
  return time_at(time, (column + 0.5) / kColumns);
}

std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Rigid3d& body_from_velodyne, const ScanTime& time,
                                   std::size_t* left_out) {
  if (bytes.size() % kScanRecordBytes != 0)
    throw InputError(file, "size", std::to_string(bytes.size()) + " bytes",
                     "must be a multiple of 16: four floats for each point (truncated?)");
  const std::size_t n = bytes.size() / kScanRecordBytes;
  if (n > kMaxScanPoints)
    throw InputError(file, "number of points", std::to_string(n),
                     "at most 4 million are accepted: a revolution has fewer");
  std::vector<LidarPoint> points;
  points.reserve(n);
  UnusableReturns unusable(n);
  int ring = 0;
  double fraction = 0;  // share of the ring's turn
  for (std::size_t i = 0; i < n; ++i) {
    float values[4];
    for (std::size_t k = 0; k < 4; ++k)
      values[k] = little_endian<float>(bytes, kScanRecordBytes * i + 4 * k);
    if (is_missing_return(values)) {
      unusable.add_missing();
      continue;
    }
    const auto* const wrong = std::find_if(values, values + 4, [&](const float& value) {
      return &value < values + 3 ? std::abs(value) > kMaxScanCoordinate_m : value < 0 || value > 1;
    });
    if (wrong != values + 4) {
      const auto k = static_cast<std::size_t>(wrong - values);
      unusable.add_impossible(
          InputError(file,
                     "point " + std::to_string(i) + " " +
                         std::string(k < 3 ? std::string(1, "xyz"[k]) : "reflectance"),
                     std::to_string(*wrong),
                     k < 3 ? "the sensor does not see further than 1000 m; metres are expected"
                           : "must be between 0 and 1"));
      continue;
    }
    // A ring begins ahead and turns to the left; the file has one after the other.
    const double before = std::exchange(fraction, fraction_of_turn(values[0], values[1]));
    ring += fraction < before - 0.5;
    points.push_back(
        {.in_body_m =
             (body_from_velodyne * Eigen::Vector3d(values[0], values[1], values[2])).cast<float>(),
         .intensity = intensity_in_16_bits(values[3]),
         .ring = static_cast<std::uint8_t>(std::min<int>(ring, kNoRing)),
         .t_ns = time_of_point(time, values[0], values[1])});
  }
  std::stable_sort(points.begin(), points.end(),
                   [](const LidarPoint& a, const LidarPoint& b) { return a.t_ns < b.t_ns; });
  if (left_out) *left_out += unusable.count();
  return points;
}

}  // namespace redrive::kitti
