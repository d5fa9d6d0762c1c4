// SPDX-License-Identifier: Apache-2.0
// NCore's model of a spinning LiDAR, row-offset-spinning: rows from the highest beam to the lowest,
// columns in the direction of rotation. A ray has the elevation of its row, and the azimuth of its
// column plus the row's offset, to the left of the sensor's x axis.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive::ncore {

class BeamModel {
 public:
  /// The first column is where beams without an offset look at the earliest of `points`, a
  /// revolution. `sensor`: with known rate and steps, as estimated for `body_from_lidar`.
  BeamModel(const LidarSensor& sensor, const Rigid3d& body_from_lidar,
            std::span<const LidarPoint> points);

  nlohmann::ordered_json json() const;  ///< {"type", "parameters"}
  /// Returns row and column of each point in turn; nothing where a point belongs to no beam.
  std::vector<std::uint16_t> elements(std::span<const LidarPoint> points) const;

 private:
  std::uint16_t column_of(const Eigen::Vector3f& in_body, std::uint8_t beam) const;

  LidarSensor sensor_;
  Rigid3d body_from_lidar_;
  double start_rad_ = 0;  ///< azimuth of the first column
};

}  // namespace redrive::ncore
