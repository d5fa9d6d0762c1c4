// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"

#include <algorithm>
#include <cmath>
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
constexpr int kRings = 32;
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
  if (!(ring >= 0 && ring < kRings && ring == std::floor(ring))) {
    impossible(4, "must be the number of a laser, 0 to 31");
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

}  // namespace

std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Revolution& revolution,
                                   const std::vector<FramePose>& poses, std::size_t* left_out) {
  if (bytes.size() % kScanRecordBytes != 0)
    throw InputError(file, "size", std::to_string(bytes.size()) + " bytes",
                     "must be a multiple of 20: five floats for each point (truncated?)");
  const std::size_t n = bytes.size() / kScanRecordBytes;
  UnusableReturns unusable(n);
  std::vector<Record> records;
  for (std::size_t i = 0; i < n; ++i) {
    std::optional<Record> record = read_record(bytes, i, file, &unusable);
    if (!record) continue;
    if (!records.empty()) {
      const Record& before = records.back();
      record->column = before.column + (record->ring() <= before.ring());
    }
    records.push_back(*record);
  }
  const std::size_t columns = records.empty() ? 0 : records.back().column + 1;
  if (columns > kMaxColumns)
    throw InputError(file, "number of columns", std::to_string(columns),
                     "a revolution has about 1085, in each of which the rings increase; at most "
                     "1302 are accepted");
  const Rigid3d global_from_lidar = pose_at(poses, revolution.end_ns) * revolution.body_from_lidar;
  std::vector<LidarPoint> points;
  points.reserve(records.size());
  std::optional<std::size_t> placed;  // column of the pose
  Rigid3d body_from_compensated = Rigid3d::Identity();
  for (const Record& record : records) {
    if (record.missing) {
      unusable.add_missing();
      continue;
    }
    const std::int64_t t_ns =
        revolution.end_ns - kFiring_ns * static_cast<std::int64_t>(columns - 1 - record.column);
    if (placed != record.column)
      body_from_compensated = pose_at(poses, t_ns).inverse(Eigen::Isometry) * global_from_lidar;
    placed = record.column;
    const float* const v = record.values;
    points.push_back(
        {.in_body_m = (body_from_compensated * Eigen::Vector3d(v[0], v[1], v[2])).cast<float>(),
         .intensity = static_cast<std::uint16_t>(std::lround(std::clamp(v[3], 0.0f, 255.0f))),
         .ring = static_cast<std::uint8_t>(record.ring()),
         .t_ns = t_ns});
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

std::string make_scan(std::span<const LidarRecord> points) {
  std::string bytes;
  for (const LidarRecord& point : points)
    for (const double value : {-point.position_m.y(), point.position_m.x(), point.position_m.z(),
                               255.0 * point.intensity, double(point.ring)})
      add_bytes(static_cast<float>(value), &bytes);
  return bytes;
}

}  // namespace redrive::nuscenes
