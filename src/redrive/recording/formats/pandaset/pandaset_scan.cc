// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pandaset/pandaset_scan.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/gzip.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/lidar/unusable_returns.h"
#include "redrive/recording/parse/data_frame.h"

namespace redrive::pandaset {
namespace {

constexpr double kMaxRange_m = 1000;
constexpr std::size_t kColumns = 5;
constexpr const char* kNames[kColumns] = {"x", "y", "z", "i", "t"};

/// Returns the beam of the Pandar64 that is nearest to an elevation. Its beams are at least 0.17
/// degrees apart; the car's LiDAR has them within 0.05 degrees of the data sheet.
std::uint8_t ring_of(double elevation_rad) {
  static const std::vector<LidarBeam> beams = parse_lidar_sensor("pandar64")->beams;
  auto above = std::ranges::lower_bound(beams, elevation_rad, {}, &LidarBeam::elevation_rad);
  if (above == beams.end() ||
      (above != beams.begin() &&
       elevation_rad - (above - 1)->elevation_rad < above->elevation_rad - elevation_rad))
    --above;
  return static_cast<std::uint8_t>(above - beams.begin());
}

}  // namespace

std::int64_t nanoseconds(double seconds) {
  const double whole = std::floor(seconds);
  return std::int64_t{1'000'000'000} * static_cast<std::int64_t>(whole) +
         std::llround(1e9 * (seconds - whole));
}

std::string unpack(std::string_view bytes, const std::filesystem::path& file) {
  std::optional<std::string> unpacked = gunzip_at_most(kMaxPickleBytes, bytes);
  if (!unpacked)
    throw InputError(file, "", "", "is no whole gzip file of at most 256 MB (truncated?)");
  return *std::move(unpacked);
}

std::vector<LidarPoint> parse_scan(std::string_view pickle, const std::filesystem::path& file,
                                   Lidar lidar, const std::vector<FramePose>& frames,
                                   const Rigid3d& body_from_lidar, std::size_t* left_out) {
  const DataFrame table(pickle, file);
  const std::vector<double>* columns[kColumns];
  for (std::size_t k = 0; k < kColumns; ++k) columns[k] = &table.numbers(kNames[k]);
  const auto value = [&](std::size_t k, std::size_t i) { return (*columns[k])[i]; };
  const std::vector<double>& sensor = table.numbers("d");
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < table.rows(); ++i)
    if (sensor[i] == static_cast<double>(lidar)) rows.push_back(i);
  std::ranges::stable_sort(rows, {}, [&](std::size_t i) { return value(4, i); });

  UnusableReturns unusable(rows.size());
  const auto impossible = [&](std::size_t i, std::size_t k, const char* rule) {
    unusable.add_impossible(InputError(file, "row " + std::to_string(i) + " " + kNames[k],
                                       std::to_string(value(k, i)), rule));
  };
  std::vector<LidarPoint> points;
  points.reserve(rows.size());
  const Rigid3d lidar_from_body = body_from_lidar.inverse(Eigen::Isometry);
  std::optional<std::int64_t> placed_ns;
  Rigid3d body_from_world = Rigid3d::Identity();
  for (const std::size_t i : rows) {
    const Eigen::Vector3d in_world(value(0, i), value(1, i), value(2, i));
    const double intensity = value(3, i), t_s = value(4, i);
    if (!in_world.allFinite() || !std::isfinite(intensity) || !std::isfinite(t_s)) {
      unusable.add_missing();
    } else if (intensity < 0 || intensity > 255) {
      impossible(i, 3, "intensities are 0 to 255");
    } else if (t_s < 0 || t_s > kMaxTime_s) {
      impossible(i, 4, "seconds since 1970");
    } else {
      const std::int64_t t_ns = nanoseconds(t_s);
      if (placed_ns != t_ns) body_from_world = pose_at(frames, t_ns).inverse(Eigen::Isometry);
      placed_ns = t_ns;
      const Eigen::Vector3d in_body = body_from_world * in_world;
      const Eigen::Vector3d in_lidar = lidar_from_body * in_body;
      const double range_m = in_lidar.norm();
      if (!(range_m <= kMaxRange_m)) {
        impossible(i, 0, "more than 1000 m away from the LiDAR at that time");
        continue;
      }
      points.push_back({.in_body_m = in_body.cast<float>(),
                        .intensity = static_cast<std::uint16_t>(std::lround(intensity)),
                        .ring = lidar == Lidar::kPandar64 && range_m > 0
                                    ? ring_of(std::asin(in_lidar.z() / range_m))
                                    : kNoRing,
                        .t_ns = t_ns});
    }
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

}  // namespace redrive::pandaset
