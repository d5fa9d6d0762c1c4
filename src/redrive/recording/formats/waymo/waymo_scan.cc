// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/waymo/waymo_scan.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::waymo {
namespace {

constexpr double kMaxRange_m = 1000, kMostIntensity = 1e6;
constexpr double kLeastWay_m = 0.1;  // way of a revolution, to tell times by places
constexpr std::size_t kMostRows = 512;

/// Inclination of each row.
std::vector<double> inclinations_of(const LaserContext& laser, std::size_t rows) {
  std::vector<double> angles = laser.inclinations_rad;
  if (angles.empty())
    for (std::size_t i = 0; i < rows; ++i)
      angles.push_back(laser.least_rad + (static_cast<double>(i) + 0.5) / double(rows) *
                                             (laser.most_rad - laser.least_rad));
  std::ranges::reverse(angles);
  return angles;
}

/// Pose of a pixel: roll, pitch, yaw, x, y, z, where the last angle turns first.
Rigid3d pose_of(const float* p) {
  return Rigid3d(Eigen::Translation3d(p[3], p[4], p[5]) *
                 Eigen::AngleAxisd(p[2], Eigen::Vector3d::UnitZ()) *
                 Eigen::AngleAxisd(p[1], Eigen::Vector3d::UnitY()) *
                 Eigen::AngleAxisd(p[0], Eigen::Vector3d::UnitX()));
}

/// Times of a revolution's places: along the chord between its ends, or by column.
class RevolutionTimes {
 public:
  RevolutionTimes(const Revolution& revolution, const std::vector<FramePose>& poses,
                  std::size_t columns)
      : begin_ns_(revolution.begin_ns),
        length_ns_(static_cast<double>(revolution.end_ns - revolution.begin_ns)),
        columns_(static_cast<double>(columns)),
        from_(pose_at(poses, revolution.begin_ns).translation()),
        way_(pose_at(poses, revolution.end_ns).translation() - from_) {}

  std::int64_t t_ns(const Eigen::Vector3d& in_world, std::size_t column) const {
    double share = (static_cast<double>(column) + 0.5) / columns_;
    if (way_.norm() >= kLeastWay_m)
      share = std::clamp((in_world - from_).dot(way_) / way_.squaredNorm(), 0.0, 1.0);
    return begin_ns_ + std::llround(share * length_ns_);
  }

 private:
  std::int64_t begin_ns_;
  double length_ns_, columns_;
  Eigen::Vector3d from_, way_;
};

/// A range image unpacked.
struct Pixels {
  std::string name;                      ///< for messages
  std::vector<double> inclinations_rad;  ///< one for each row
  std::size_t columns = 0, channels = 0;
  std::vector<float> values;  ///< [rows, columns, channels]
  std::vector<float> poses;   ///< [rows, columns, 6]; empty: none
};

Pixels unpack(const ByteSource& bytes, const RangeImage& image, const LaserContext& laser,
              const std::filesystem::path& file) {
  Pixels out;
  out.name = "range image of " + laser_name(image.laser);
  const auto fail = [&](const std::string& rule) { throw InputError(file, out.name, "", rule); };
  Matrix ranges = parse_matrix(bytes, image.first, file, out.name);
  if (ranges.dims.size() != 3 || ranges.dims[2] < 2) fail("must have rows, columns and 4 channels");
  const auto rows = static_cast<std::size_t>(ranges.dims[0]);
  out.columns = static_cast<std::size_t>(ranges.dims[1]);
  out.channels = static_cast<std::size_t>(ranges.dims[2]);
  out.values = std::move(ranges.values);
  out.inclinations_rad = inclinations_of(laser, rows);
  if (rows > kMostRows || out.inclinations_rad.size() != rows)
    fail("has " + std::to_string(rows) + " rows, its calibration " +
         std::to_string(out.inclinations_rad.size()));
  if (image.poses.size() == 0) return out;
  Matrix placed = parse_matrix(bytes, image.poses, file, out.name + "'s poses");
  if (placed.dims != std::vector<std::int64_t>{ranges.dims[0], ranges.dims[1], 6})
    fail("must have a pose of 6 numbers for each pixel");
  out.poses = std::move(placed.values);
  return out;
}

}  // namespace

std::vector<LidarPoint> read_scan(const ByteSource& bytes, const RangeImage& image,
                                  const LaserContext& laser, const Revolution& revolution,
                                  const std::vector<FramePose>& poses,
                                  const std::filesystem::path& file, std::size_t* left_out) {
  const Pixels pixels = unpack(bytes, image, laser, file);
  const std::size_t rows = pixels.inclinations_rad.size(), columns = pixels.columns;
  // Rows of the image turn about the body's z axis, where the sensor's x axis may look anywhere.
  const Eigen::Matrix3d turn = laser.body_from_laser.linear();
  const double heading_rad = std::atan2(turn(1, 0), turn(0, 0));
  const RevolutionTimes times(revolution, poses, columns);
  UnusableReturns unusable(rows * columns);
  std::vector<LidarPoint> points;
  for (std::size_t column = 0; column < columns; ++column) {
    const double azimuth =
        (1 - 2 * (static_cast<double>(column) + 0.5) / double(columns)) * std::numbers::pi -
        heading_rad;
    for (std::size_t row = 0; row < rows; ++row) {
      const std::size_t pixel = row * columns + column;
      const float range_m = pixels.values[pixel * pixels.channels],
                  intensity = pixels.values[pixel * pixels.channels + 1];
      if (range_m <= 0) continue;  // a lost ray
      if (std::isnan(range_m)) {
        unusable.add_missing();
        continue;
      }
      const auto refuse = [&](const char* what, double value, const char* rule) {
        unusable.add_impossible(InputError(file,
                                           pixels.name + ", " + what + " of row " +
                                               std::to_string(row) + " column " +
                                               std::to_string(column),
                                           std::to_string(value), rule));
      };
      if (!(range_m <= kMaxRange_m)) {
        refuse("range", range_m, "must be at most 1000 m");
        continue;
      }
      if (!(intensity >= 0 && intensity <= kMostIntensity)) {
        refuse("intensity", intensity, "must be 0 to 1e6");
        continue;
      }
      const Eigen::Vector3d in_body =
          laser.body_from_laser * (range_m * beam_direction(pixels.inclinations_rad[row], azimuth));
      LidarPoint point{.in_body_m = in_body.cast<float>(),
                       .intensity = intensity_in_16_bits(std::tanh(intensity)),
                       .ring = static_cast<std::uint8_t>(row < kNoRing ? row : kNoRing),
                       .t_ns = revolution.begin_ns};
      Rigid3d world_from_body = revolution.world_from_body;
      if (!pixels.poses.empty()) {
        world_from_body = pose_of(&pixels.poses[6 * pixel]);
        if (!(world_from_body.translation().norm() <= kMaxCoordinate_m) ||
            !world_from_body.linear().allFinite()) {
          refuse("pose", world_from_body.translation().norm(), "must be within 1e7 m");
          continue;
        }
        point.t_ns = times.t_ns(world_from_body.translation(), column);
      }
      const Eigen::Vector3d then =
          pose_at(poses, point.t_ns).inverse(Eigen::Isometry) * (world_from_body * in_body);
      if (!(then.norm() <= 2 * kMaxRange_m)) {
        refuse("pose", then.norm(), "must be near the car's");
        continue;
      }
      point.in_body_m = then.cast<float>();
      points.push_back(point);
    }
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

}  // namespace redrive::waymo
