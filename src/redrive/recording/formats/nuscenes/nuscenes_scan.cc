// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/lidar/unusable_returns.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::nuscenes {
namespace {

// interval between firings of all lasers: HDL-32E User's Manual, appendix E
constexpr std::int64_t kFiring_ns = 46'080;
constexpr std::size_t kMaxColumns = 1302;  // 60 ms; a revolution at 20 Hz has 1085
constexpr float kMaxScanCoordinate_m = 1000;
constexpr int kRings = 32, kMostRings = kNoRing;
constexpr const char* kFieldNames[] = {"x", "y", "z", "intensity", "ring"};

struct Record {
  float values[5];
  std::size_t column = 0;
  bool missing = false;  ///< its direction has no return; it still belongs to a column
  int ring() const { return static_cast<int>(values[4]); }
};

/// Reads a record; returns nothing, and counts it, where a value is impossible.
std::optional<Record> read_record(std::string_view bytes, std::size_t i,
                                  const std::filesystem::path& file, UnusableReturns* unusable) {
  Record record;
  for (std::size_t k = 0; k < 5; ++k)
    record.values[k] = little_endian<float>(bytes, kScanRecordBytes * i + 4 * k);
  const auto impossible = [&](std::size_t k, const char* rule) {
    unusable->add_impossible(InputError(file, "point " + std::to_string(i) + " " + kFieldNames[k],
                                        std::to_string(record.values[k]), rule));
  };
  const float ring = record.values[4];
  if (!(ring >= 0 && ring < kMostRings && ring == std::floor(ring))) {
    impossible(4, "must be the number of a laser, 0 to 254");
    return std::nullopt;
  }
  record.missing = is_missing_return(record.values);
  for (std::size_t k = 0; k < 3 && !record.missing; ++k)
    if (std::abs(record.values[k]) > kMaxScanCoordinate_m) {
      impossible(k, "the sensor does not see further than 1000 m; metres are expected");
      return std::nullopt;
    }
  return record;
}

std::int64_t duration_or_usual(std::int64_t duration_ns) {
  constexpr std::int64_t kUsual_ns = 100'000'000;
  return duration_ns != 0 ? duration_ns : kUsual_ns;
}

/// The records of a file by columns: a new one begins where the ring does not increase.
struct Columns {
  std::vector<Record> records;
  std::size_t n = 0;
  bool is_hdl_32e = false, has_rings = false;
};
/// `duration_ns`: length of a revolution; 0: not known.
Columns columns_of(std::string_view bytes, const std::filesystem::path& file,
                   std::int64_t duration_ns, UnusableReturns* unusable) {
  if (bytes.size() % kScanRecordBytes != 0)
    throw InputError(file, "size", std::to_string(bytes.size()) + " bytes",
                     "must be a multiple of 20: five floats for each point (truncated?)");
  Columns columns;
  int most_ring = 0;
  for (std::size_t i = 0; i < bytes.size() / kScanRecordBytes; ++i) {
    std::optional<Record> record = read_record(bytes, i, file, unusable);
    if (!record) continue;
    if (!columns.records.empty()) {
      const Record& before = columns.records.back();
      record->column = before.column + (record->ring() <= before.ring());
    }
    most_ring = std::max(most_ring, record->ring());
    columns.records.push_back(*record);
  }
  columns.n = columns.records.empty() ? 0 : columns.records.back().column + 1;
  columns.has_rings = most_ring > 0;
  constexpr std::int64_t kMostOff_ns = 5'000'000;
  columns.is_hdl_32e =
      most_ring >= kRings / 2 && most_ring < kRings && columns.n <= kMaxColumns &&
      (duration_ns == 0 || std::abs(duration_ns - Spin().duration_ns) <= kMostOff_ns);
  return columns;
}

/// Returns how the azimuth of records runs; turn 0 where their order is no revolution or a large
/// part of one.
Spin turn_of(const std::vector<Record>& records, std::int64_t duration_ns) {
  std::vector<Eigen::Vector2d> all;
  for (const Record& record : records)
    if (!record.missing) all.emplace_back(record.values[0], record.values[1]);
  Spin spin{duration_or_usual(duration_ns), 0, 0};
  constexpr std::size_t kSectors = 64, kFewest = 8 * kSectors;
  if (all.size() < kFewest) return spin;
  // Directions of sectors, to which far returns count most: the car's motion turns near ones.
  std::vector<double> azimuths;
  double sum_of_sizes = 0;
  for (std::size_t k = 0; k < kSectors; ++k) {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (std::size_t i = k * all.size() / kSectors; i < (k + 1) * all.size() / kSectors; ++i)
      sum += all[i];
    double azimuth = std::atan2(sum.y(), sum.x());
    if (k > 0) {
      const double step = std::remainder(azimuth - azimuths.back(), 2 * std::numbers::pi);
      azimuth = azimuths.back() + step;
      sum_of_sizes += std::abs(step);
    }
    azimuths.push_back(azimuth);
  }
  const double sum = azimuths.back() - azimuths.front(),
               turns = std::abs(sum) / (2 * std::numbers::pi);
  constexpr double kLeastTurn = 0.3, kMostTurn = 1.1, kSteady = 0.8;
  if (turns < kLeastTurn || turns > kMostTurn || std::abs(sum) < kSteady * sum_of_sizes)
    return spin;
  // Azimuths are sectors' middles; the turn begins and ends half a sector further out.
  const double first = 1.5 * azimuths[0] - 0.5 * azimuths[1],
               last = 1.5 * azimuths[kSectors - 1] - 0.5 * azimuths[kSectors - 2];
  spin.first_rad = first;
  spin.turn_rad = last - first;
  return spin;
}

/// Returns the time at which a scan sees a direction. `whole_turns(f)`: number of turns to add to
/// the direction's place f, in turns from the begin.
template <class WholeTurns>
std::int64_t time_of_azimuth(const Spin& spin, const Eigen::Vector3d& in_lidar, std::int64_t end_ns,
                             const WholeTurns& whole_turns) {
  const double turn = 2 * std::numbers::pi / std::abs(spin.turn_rad);
  double fraction = (std::atan2(in_lidar.y(), in_lidar.x()) - spin.first_rad) / spin.turn_rad;
  fraction += turn * whole_turns(fraction / turn);
  return end_ns - std::llround((1 - std::clamp(fraction, 0.0, 1.0)) * double(spin.duration_ns));
}

}  // namespace

std::int64_t Spin::time_of(const Eigen::Vector3d& in_lidar, std::int64_t end_ns) const {
  if (turn_rad == 0) return end_ns;
  return time_of_azimuth(*this, in_lidar, end_ns, [](double turns) { return -std::floor(turns); });
}

Spin spin_of(std::string_view bytes, const std::filesystem::path& file, std::int64_t duration_ns) {
  UnusableReturns unusable(bytes.size() / kScanRecordBytes);
  const Columns columns = columns_of(bytes, file, duration_ns, &unusable);
  return columns.is_hdl_32e ? Spin() : turn_of(columns.records, duration_ns);
}

std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Revolution& revolution,
                                   const std::vector<FramePose>& poses, std::size_t* left_out) {
  UnusableReturns unusable(bytes.size() / kScanRecordBytes);
  const auto [records, n_columns, is_hdl_32e, has_rings] =
      columns_of(bytes, file, revolution.spin.duration_ns, &unusable);
  const Spin& spin = revolution.spin;
  const double column_ns = is_hdl_32e           ? kFiring_ns
                           : spin.turn_rad == 0 ? 0
                                                : double(spin.duration_ns) / double(n_columns);
  const bool by_azimuth = !is_hdl_32e && !has_rings && spin.turn_rad != 0;
  const Spin own = by_azimuth ? turn_of(records, spin.duration_ns) : spin;
  const Rigid3d global_from_lidar = pose_at(poses, revolution.end_ns) * revolution.body_from_lidar;
  std::vector<LidarPoint> points;
  points.reserve(records.size());
  std::int64_t posed_ns = std::numeric_limits<std::int64_t>::min();
  Rigid3d body_from_compensated = Rigid3d::Identity();
  for (const Record& record : records) {
    if (record.missing) {
      unusable.add_missing();
      continue;
    }
    const Eigen::Vector3d in_file(record.values[0], record.values[1], record.values[2]);
    std::int64_t t_ns =
        revolution.end_ns - std::llround(column_ns * double(n_columns - 1 - record.column));
    if (by_azimuth && own.turn_rad != 0) {
      // The azimuth at a time is seen from where the sensor is then.
      constexpr int kIterations = 4;
      // Share of the records up to this one, in turns: tells whole turns apart.
      const double part = double(record.column + 1) / double(n_columns) * std::abs(own.turn_rad) /
                          (2 * std::numbers::pi);
      const auto whole_turns = [&](double turns) { return std::round(part - turns); };
      Eigen::Vector3d in_lidar = in_file;
      for (int i = 0; i < kIterations; ++i) {
        t_ns = time_of_azimuth(own, in_lidar, revolution.end_ns, whole_turns);
        in_lidar = (pose_at(poses, t_ns) * revolution.body_from_lidar).inverse(Eigen::Isometry) *
                   (global_from_lidar * in_file);
      }
    }
    if (posed_ns != t_ns)
      body_from_compensated = pose_at(poses, t_ns).inverse(Eigen::Isometry) * global_from_lidar;
    posed_ns = t_ns;
    points.push_back({.in_body_m = (body_from_compensated * in_file).cast<float>(),
                      .intensity = static_cast<std::uint16_t>(
                          std::lround(std::clamp(record.values[3], 0.0f, 255.0f))),
                      .ring = has_rings ? static_cast<std::uint8_t>(record.ring()) : kNoRing,
                      .t_ns = t_ns});
  }
  if (by_azimuth) std::ranges::stable_sort(points, {}, &LidarPoint::t_ns);
  if (left_out) *left_out += unusable.count();
  return points;
}

std::string make_scan(std::span<const LidarRecord> points) {
  std::string bytes;
  for (const LidarRecord& point : points)
    for (const double value :
         {-point.position_m.y(), point.position_m.x(), point.position_m.z(),
          255.0 * point.intensity, double(point.ring == kNoRing ? 0 : point.ring)})
      add_bytes(static_cast<float>(value), &bytes);
  return bytes;
}

}  // namespace redrive::nuscenes
