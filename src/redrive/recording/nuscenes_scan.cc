// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/nuscenes_scan.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/little_endian.h"
#include "redrive/recording/trajectory.h"

namespace redrive::nuscenes {
namespace {

constexpr std::int64_t kFiring_ns = 46'080;  // of all lasers: HDL-32E User's Manual, appendix E
constexpr std::size_t kMaxColumns = 1302;    // 60 ms; a revolution at 20 Hz has 1085
constexpr float kMaxScanCoordinate_m = 1000;
constexpr int kRings = 32;
constexpr const char* kFieldNames[] = {"x", "y", "z", "intensity", "ring"};

struct Record {
  float values[5];
  int ring() const { return static_cast<int>(values[4]); }
};

Record read_record(std::string_view bytes, std::size_t i, const std::filesystem::path& file) {
  Record record;
  for (std::size_t k = 0; k < 5; ++k) {
    const float value = record.values[k] =
        little_endian<float>(bytes, kScanRecordBytes * i + 4 * k);
    const auto fail = [&](const char* rule) {
      throw InputError(file, "point " + std::to_string(i) + " " + kFieldNames[k],
                       std::to_string(value), rule);
    };
    if (k < 3 && !(std::abs(value) <= kMaxScanCoordinate_m))
      fail("the sensor does not see further than 1000 m; metres are expected");
    if (k == 3 && !std::isfinite(value)) fail("must be finite");
    if (k == 4 && !(value >= 0 && value < kRings && value == std::floor(value)))
      fail("must be the number of a laser, 0 to 31");
  }
  return record;
}

}  // namespace

std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Revolution& revolution,
                                   const std::vector<FramePose>& poses) {
  if (bytes.size() % kScanRecordBytes != 0)
    throw InputError(file, "size", std::to_string(bytes.size()) + " bytes",
                     "must be a multiple of 20: five floats for each point (truncated?)");
  std::vector<Record> records(bytes.size() / kScanRecordBytes);
  std::vector<std::size_t> column(records.size());
  for (std::size_t i = 0; i < records.size(); ++i) {
    records[i] = read_record(bytes, i, file);
    if (i > 0) column[i] = column[i - 1] + (records[i].ring() <= records[i - 1].ring());
  }
  const std::size_t columns = records.empty() ? 0 : column.back() + 1;
  if (columns > kMaxColumns)
    throw InputError(file, "number of columns", std::to_string(columns),
                     "a revolution has about 1085, in each of which the rings increase; at most "
                     "1302 are accepted");
  const Rigid3d global_from_lidar = pose_at(poses, revolution.end_ns) * revolution.body_from_lidar;
  std::vector<LidarPoint> points(records.size());
  Rigid3d body_from_compensated;
  for (std::size_t i = 0; i < records.size(); ++i) {
    const std::int64_t t_ns =
        revolution.end_ns - kFiring_ns * static_cast<std::int64_t>(columns - 1 - column[i]);
    if (i == 0 || column[i] != column[i - 1])
      body_from_compensated = pose_at(poses, t_ns).inverse(Eigen::Isometry) * global_from_lidar;
    const float* const v = records[i].values;
    points[i] = {
        .in_body_m = (body_from_compensated * Eigen::Vector3d(v[0], v[1], v[2])).cast<float>(),
        .intensity = static_cast<std::uint16_t>(std::lround(std::clamp(v[3], 0.0f, 255.0f))),
        .t_ns = t_ns};
  }
  return points;
}

}  // namespace redrive::nuscenes
