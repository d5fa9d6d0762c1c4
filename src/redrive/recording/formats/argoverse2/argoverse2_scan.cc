// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "redrive/base/error.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"
#include "redrive/recording/lidar/unusable_returns.h"
#include "redrive/recording/parse/arrow_table.h"

namespace redrive::argoverse2 {
namespace {

constexpr double kMaxRange_m = 1000;
constexpr double kMaxOffset_ns = 1e9;
constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kRate_rad_per_ns = kTurn_rad / double(kRevolution_ns);

struct ScanColumn {
  const char* name;
  double least, most;
  const char* rule;
};
constexpr ScanColumn kColumns[] = {
    {"x", -kMaxRange_m, kMaxRange_m, "at most 1000 m away"},
    {"y", -kMaxRange_m, kMaxRange_m, "at most 1000 m away"},
    {"z", -kMaxRange_m, kMaxRange_m, "at most 1000 m away"},
    {"intensity", 0, 255, "0 to 255"},
    {"laser_number", 0, 2 * kLasersOfLidar - 1, "0 to 63"},
    {"offset_ns", -kMaxOffset_ns, kMaxOffset_ns, "at most a second"}};

bool is_laser_of(Lidar lidar, double laser) {
  return (laser < kLasersOfLidar) == (lidar == Lidar::kUp);
}

}  // namespace

bool has_lasers_of(Lidar lidar, std::string_view feather, const std::filesystem::path& file) {
  return std::ranges::any_of(ArrowTable(feather, file).numbers("laser_number"),
                             [&](double laser) { return is_laser_of(lidar, laser); });
}

std::vector<LidarPoint> parse_scan(std::string_view feather, const std::filesystem::path& file,
                                   Lidar lidar, std::int64_t t_ns,
                                   const std::vector<FramePose>& poses, std::size_t* left_out) {
  const ArrowTable table(feather, file);
  std::vector<double> columns[std::size(kColumns)];
  for (std::size_t k = 0; k < std::size(kColumns); ++k)
    columns[k] = table.numbers(kColumns[k].name);
  const std::vector<double>& offsets_ns = columns[5];
  std::vector<std::size_t> rows(table.rows());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  std::erase_if(rows, [&](std::size_t i) {
    return std::ranges::any_of(columns,
                               [&](const auto& column) { return !std::isfinite(column[i]); });
  });
  UnusableReturns unusable(table.rows());
  for (std::size_t i = rows.size(); i < table.rows(); ++i) unusable.add_missing();
  std::ranges::stable_sort(rows, {}, [&](std::size_t i) { return offsets_ns[i]; });

  const Rigid3d world_from_vehicle = pose_at(poses, t_ns) * body_from_vehicle();
  std::vector<LidarPoint> points;
  points.reserve(rows.size());
  std::optional<std::int64_t> placed_ns;
  Rigid3d body_from_vehicle_then = Rigid3d::Identity();
  for (const std::size_t i : rows) {
    std::size_t k = 0;
    while (k < std::size(kColumns) && columns[k][i] >= kColumns[k].least &&
           columns[k][i] <= kColumns[k].most)
      ++k;
    if (k < std::size(kColumns)) {
      unusable.add_impossible(
          InputError(file, std::string(kColumns[k].name) + " of row " + std::to_string(i),
                     std::to_string(columns[k][i]), kColumns[k].rule));
      continue;
    }
    const std::int64_t at_ns = t_ns + static_cast<std::int64_t>(offsets_ns[i]);
    if (placed_ns != at_ns)
      body_from_vehicle_then = pose_at(poses, at_ns).inverse(Eigen::Isometry) * world_from_vehicle;
    placed_ns = at_ns;
    const Eigen::Vector3d in_body =
        body_from_vehicle_then * Eigen::Vector3d(columns[0][i], columns[1][i], columns[2][i]);
    if (!(in_body.norm() <= 2 * kMaxRange_m)) {
      unusable.add_impossible(InputError(file, "row " + std::to_string(i),
                                         std::to_string(in_body.norm()) + " m away",
                                         "from where the car is at its time"));
      continue;
    }
    const int laser = static_cast<int>(columns[4][i]);
    if (!is_laser_of(lidar, laser)) continue;
    points.push_back({.in_body_m = in_body.cast<float>(),
                      .intensity = static_cast<std::uint16_t>(std::lround(columns[3][i])),
                      .ring = static_cast<std::uint8_t>(laser % kLasersOfLidar),
                      .t_ns = at_ns});
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

std::int64_t SweepTiming::seen_after_ns(const Eigen::Vector3d& in_body) const {
  const Eigen::Vector3d seen = in_body - lidar_in_body;
  const double turned =
      (turns_left ? 1 : -1) * (std::atan2(seen.y(), seen.x()) - azimuth_at_first_rad) / kTurn_rad;
  return first_ns + std::llround((turned - std::floor(turned)) * double(kRevolution_ns));
}

std::optional<SweepTiming> sweep_timing(const std::vector<LidarPoint>& points, std::int64_t t_ns,
                                        const Rigid3d& body_from_lidar) {
  if (points.empty()) return std::nullopt;
  SweepTiming timing{.first_ns = points.front().t_ns - t_ns,
                     .lidar_in_body = body_from_lidar.translation()};
  // Azimuths at the first return agree for the direction in which it turns.
  double least = 0;
  for (const bool left : {false, true}) {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const LidarPoint& point : points) {
      const Eigen::Vector3d seen = point.in_body_m.cast<double>() - timing.lidar_in_body;
      const double turned_rad =
          kRate_rad_per_ns * double(point.t_ns - points.front().t_ns) * (left ? 1 : -1);
      const double at_first = std::atan2(seen.y(), seen.x()) - turned_rad;
      sum += Eigen::Vector2d(std::cos(at_first), std::sin(at_first));
    }
    if (!(sum.norm() > least)) continue;
    least = sum.norm();
    timing.turns_left = left;
    timing.azimuth_at_first_rad = std::atan2(sum.y(), sum.x());
  }
  if (least == 0) return std::nullopt;
  return timing;
}

}  // namespace redrive::argoverse2
