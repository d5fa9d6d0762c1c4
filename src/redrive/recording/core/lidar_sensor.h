// SPDX-License-Identifier: Apache-2.0
// LiDAR sensors: when and in which directions they fire during a revolution.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "redrive/math/rigid3.h"

namespace redrive {

/// Pulses of a revolution, by time. Axes of a sensor: x forward, y left, z up.
struct LidarFirings {
  std::vector<Eigen::Vector3d> direction;  ///< unit, in the sensor's axes
  std::vector<std::int64_t> t_ns;
  std::vector<std::uint8_t> ring;  ///< as LidarPoint::ring
  std::vector<float> range_m;      ///< recorded ranges; empty where none were recorded

  std::size_t size() const { return t_ns.size(); }
};

/// Rays of one time that are nearer than this are one ray, whose sensor reports several surfaces:
/// others are 0.2 degrees apart.
constexpr double kSameRay_rad = 5e-4;

/// A beam turns about the sensor's z axis at a fixed elevation.
struct LidarBeam {
  double elevation_rad = 0;  ///< upwards from the plane of rotation
  double azimuth_rad = 0;    ///< to the left of the sensor's heading
};

/// Returns the unit vector of an elevation and of an azimuth to the left of x.
inline Eigen::Vector3d beam_direction(double elevation_rad, double azimuth_rad) {
  return {std::cos(elevation_rad) * std::cos(azimuth_rad),
          std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad)};
}

/// A return as a function of an angle that is added to its elevation, in the axes of the body:
/// origin + cos(angle) ray + sin(angle) up, with |up| = |ray|, at a right angle to it in the plane
/// of the sensor's axis.
class RaisedReturn {
 public:
  RaisedReturn(const Rigid3d& body_from_sensor, const Eigen::Vector3d& in_body)
      : origin_(body_from_sensor.translation()), ray_(in_body - origin_) {
    const Eigen::Vector3d axis = body_from_sensor.linear().col(2),
                          beside = ray_ - ray_.dot(axis) * axis;
    const double beside_m = beside.norm();
    if (beside_m > 0) up_ = beside_m * axis - ray_.dot(axis) / beside_m * beside;
  }
  Eigen::Vector3d at(double angle_rad) const {
    return origin_ + std::cos(angle_rad) * ray_ + std::sin(angle_rad) * up_;
  }
  /// Returns the derivative of at().
  Eigen::Vector3d slope(double angle_rad) const {
    return std::cos(angle_rad) * up_ - std::sin(angle_rad) * ray_;
  }

 private:
  Eigen::Vector3d origin_, ray_, up_ = Eigen::Vector3d::Zero();
};

/// A pulse of a sensor that does not turn.
struct LidarPulse {
  Eigen::Vector3d direction;  ///< unit, in the sensor's axes
  double at = 0;              ///< share of the time of a frame, 0..1
  std::uint8_t ring = 0;
};

/// A spinning LiDAR, all beams of which fire together at each azimuth step, or one with a fixed
/// pattern of pulses, which has no beams.
struct LidarSensor {
  std::string name;
  std::vector<LidarBeam> beams;  ///< from the lowest to the highest; a ring is an index
  int azimuth_steps = 1800;      ///< firings of a beam in a revolution; 0: unknown
  double rate_hz = 10;           ///< revolutions a second; 0: unknown, all rays have one time
  bool clockwise = true;         ///< seen from above
  double min_range_m = 0.5, max_range_m = 200;  ///< ranges of returns
  double divergence_rad = 0;                    ///< full angle of a beam; 0: unknown
  std::vector<LidarPulse> pattern;              ///< ascending by time

  /// Returns a revolution that begins behind and looks ahead at t_ns, like KITTI's.
  LidarFirings revolution(std::int64_t t_ns) const;
};

/// Parses a sensor: the name of a known one, or the elevations of its beams: "N", as common
/// sensors with N beams have them, "N:MIN:MAX", evenly spaced, or "E1,E2,..", degrees. A single
/// elevation has a point or a sign: "5.0". Nothing unless there are 1 to 255 (for N and N:MIN:MAX
/// at least 2, MIN < MAX) within -90..90.
std::optional<LidarSensor> parse_lidar_sensor(std::string_view text);
/// Rule of that text, for error messages.
std::string lidar_sensor_rule();

/// The known sensors, by their data sheets.
const std::vector<LidarSensor>& known_lidar_sensors();
/// Their names: "vlp-16, hdl-32e, ..".
std::string known_lidar_names();

/// Returns beams at `count` elevations evenly spaced from low to high; at least two.
std::vector<LidarBeam> evenly_spaced_beams(int count, double low_deg, double high_deg);

}  // namespace redrive
