// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/point_clouds.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "redrive/base/error.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::rosbag {
namespace {

constexpr double kMaxRange_m = 1000;
constexpr double kMaxOffset_s = 10;

std::size_t bytes_of_type(std::uint8_t type) {
  constexpr std::size_t kBytes[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
  return type < std::size(kBytes) ? kBytes[type] : 0;
}

/// A field of all points, as numbers.
class Column {
 public:
  Column(const PointCloud& cloud, const PointField& field, const std::filesystem::path& file)
      : cloud_(&cloud), field_(&field), size_(bytes_of_type(field.type)) {
    if (size_ == 0)
      throw InputError(file, "fields." + field.name + ".datatype", std::to_string(field.type),
                       "is 1 to 8");
    if (size_ > cloud.point_step || field.offset > cloud.point_step - size_)
      throw InputError(file, "fields." + field.name + ".offset", std::to_string(field.offset),
                       "lies beyond point_step " + std::to_string(cloud.point_step));
  }

  /// `start`: offset of a point in the data.
  double at(std::size_t start) const {
    char raw[8];
    std::memcpy(raw, cloud_->data.data() + start + field_->offset, size_);
    if (cloud_->big_endian) std::reverse(raw, raw + size_);
    switch (field_->type) {
      case 1: return value<std::int8_t>(raw);
      case 2: return value<std::uint8_t>(raw);
      case 3: return value<std::int16_t>(raw);
      case 4: return value<std::uint16_t>(raw);
      case 5: return value<std::int32_t>(raw);
      case 6: return value<std::uint32_t>(raw);
      case 7: return static_cast<double>(value<float>(raw));
      default: return value<double>(raw);
    }
  }

 private:
  template <class T>
  static T value(const char* raw) {
    T out;
    std::memcpy(&out, raw, sizeof out);
    return out;
  }

  const PointCloud* cloud_;
  const PointField* field_;
  std::size_t size_;
};

const PointField* find_field(const PointCloud& cloud, std::initializer_list<const char*> names) {
  for (const char* name : names) {
    const auto found = std::ranges::find(cloud.fields, name, &PointField::name);
    if (found != cloud.fields.end()) return &*found;
  }
  return nullptr;
}

Column column(const PointCloud& cloud, const std::string& name, const std::filesystem::path& file) {
  const auto found = std::ranges::find(cloud.fields, name, &PointField::name);
  if (found == cloud.fields.end())
    throw InputError(file, "fields", name, "is missing in this scan");
  return Column(cloud, *found, file);
}

/// Returns where points begin.
std::vector<std::size_t> starts_of(const PointCloud& cloud, const std::filesystem::path& file) {
  const std::uint64_t row = std::uint64_t{cloud.width} * cloud.point_step,
                      step = cloud.height == 1 ? row : cloud.row_step;
  if (cloud.width == 0 || cloud.height == 0) return {};
  if (cloud.point_step == 0 || step < row || step > cloud.data.size() ||
      step * (cloud.height - 1) + row > cloud.data.size())
    throw InputError(file, "width, height, point_step, row_step",
                     std::to_string(cloud.width) + ", " + std::to_string(cloud.height) + ", " +
                         std::to_string(cloud.point_step) + ", " + std::to_string(cloud.row_step),
                     "does not fit its " + std::to_string(cloud.data.size()) + " bytes");
  std::vector<std::size_t> starts;
  for (std::uint64_t y = 0; y < cloud.height; ++y)
    for (std::uint64_t x = 0; x < cloud.width; ++x)
      starts.push_back(static_cast<std::size_t>(y * step + x * cloud.point_step));
  return starts;
}

}  // namespace

ScanFields propose_fields(const PointCloud& cloud, const std::filesystem::path& bag) {
  ScanFields fields;
  const std::vector<std::size_t> starts = starts_of(cloud, bag);
  const auto range_of = [&](const PointField& field) {
    const Column values(cloud, field, bag);
    double least = INFINITY, most = -INFINITY;
    for (const std::size_t start : starts)
      if (const double x = values.at(start); std::isfinite(x) && x != 0) {
        least = std::min(least, x);
        most = std::max(most, x);
      }
    return std::pair(least, most);
  };
  if (const PointField* ring = find_field(cloud, {"ring", "channel", "line", "laser_id"}))
    fields.ring = ring->name;
  if (const PointField* strength =
          find_field(cloud, {"intensity", "i", "reflectivity", "reflectance"})) {
    fields.intensity = strength->name;
    const double most = range_of(*strength).second;
    const bool fraction = strength->type >= 7 && most <= 1;
    fields.intensity_full = fraction ? 1 : most <= 255 ? 255 : 65535;
  }
  const PointField* time = find_field(
      cloud, {"t", "time", "timestamp", "time_stamp", "timeStamp", "offset_time", "t_offset"});
  if (!time) return fields;
  const auto [first, last] = range_of(*time);
  constexpr double kLeastSweep_s = 0.002, kMostSweep_s = 0.4, kEpoch_s = 1e6;
  for (const double unit : {1.0, 1e-3, 1e-6, 1e-9}) {
    if (!((last - first) * unit >= kLeastSweep_s && (last - first) * unit <= kMostSweep_s))
      continue;
    fields.time = time->name;
    fields.time_unit_s = unit;
    fields.since_epoch = std::abs(last) * unit > kEpoch_s;
    const double from_s = fields.since_epoch ? 1e-9 * double(cloud.header.t_ns) : 0;
    fields.middle_s = (first + last) / 2 * unit - from_s;
    fields.sweep_s = (last - first) * unit;
    if (!(std::abs(fields.middle_s) <= kMaxOffset_s)) fields.middle_s = 0;
  }
  return fields;
}

std::vector<LidarPoint> parse_scan(const PointCloud& cloud, const ScanFields& fields,
                                   std::int64_t t_ns, const Rigid3d& body_from_lidar,
                                   const std::filesystem::path& file, std::size_t* left_out) {
  const std::vector<std::size_t> starts = starts_of(cloud, file);
  const Column x = column(cloud, "x", file), y = column(cloud, "y", file),
               z = column(cloud, "z", file);
  std::optional<Column> time, intensity, ring;
  if (!fields.time.empty()) time = column(cloud, fields.time, file);
  if (!fields.intensity.empty()) intensity = column(cloud, fields.intensity, file);
  if (!fields.ring.empty()) ring = column(cloud, fields.ring, file);
  const double full = fields.intensity_full, scale = full == 255 || full == 65535 ? full : 65535;
  UnusableReturns unusable(starts.size());
  std::vector<LidarPoint> points;
  points.reserve(starts.size());
  for (std::size_t i = 0; i < starts.size(); ++i) {
    const Eigen::Vector3d p(x.at(starts[i]), y.at(starts[i]), z.at(starts[i]));
    if (!p.allFinite() || p.isZero(0)) {
      unusable.add_missing();
      continue;
    }
    if (!(p.norm() <= kMaxRange_m)) {
      unusable.add_impossible(InputError(file, "x, y, z of point " + std::to_string(i),
                                         std::to_string(p.norm()) + " m away",
                                         "is at most 1000 m away"));
      continue;
    }
    LidarPoint point{.in_body_m = (body_from_lidar * p).cast<float>(), .t_ns = t_ns};
    if (time) {
      // Times since the epoch in seconds have 53 bits: 0.2 us.
      const double offset_s = fields.since_epoch ? time->at(starts[i]) * fields.time_unit_s -
                                                       1e-9 * double(cloud.header.t_ns)
                                                 : time->at(starts[i]) * fields.time_unit_s;
      if (!(std::abs(offset_s) <= kMaxOffset_s)) {
        unusable.add_impossible(InputError(file, fields.time + " of point " + std::to_string(i),
                                           std::to_string(time->at(starts[i])),
                                           "is at most 10 s from the stamp"));
        continue;
      }
      point.t_ns = t_ns + std::llround(1e9 * offset_s);
    }
    if (intensity && std::isfinite(intensity->at(starts[i])))
      point.intensity = static_cast<std::uint16_t>(
          std::lround(std::clamp(intensity->at(starts[i]) / full, 0.0, 1.0) * scale));
    if (ring) {
      const double number = ring->at(starts[i]);
      if (number >= 0 && number < kNoRing) point.ring = static_cast<std::uint8_t>(number);
    }
    points.push_back(point);
  }
  std::ranges::stable_sort(points, {}, &LidarPoint::t_ns);
  if (left_out) *left_out += unusable.count();
  return points;
}

}  // namespace redrive::rosbag
