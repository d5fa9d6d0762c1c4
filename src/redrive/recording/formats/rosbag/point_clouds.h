// SPDX-License-Identifier: Apache-2.0
// Scans of sensor_msgs/PointCloud2. Drivers differ in how they name a point's time, ring and
// intensity, and in their units.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/formats/rosbag/messages.h"

namespace redrive::rosbag {

/// Which fields of a scan are used, and their units.
struct ScanFields {
  std::string time;          ///< empty: all points have the time of the message
  double time_unit_s = 1;    ///< 1e-9: ns
  bool since_epoch = false;  ///< false: counted from the message's stamp
  std::string intensity;     ///< empty: none
  double intensity_full = 255;
  std::string ring;     ///< empty: none
  double middle_s = 0;  ///< from a message's stamp to the middle of its points, as seen in a scan
  double sweep_s = 0;   ///< from its first to its last point
};

/// Chooses the fields by their names and the units by the values of a scan: a revolution takes 2 to
/// 400 ms. `cloud`: with all of its data.
ScanFields propose_fields(const PointCloud& cloud, const std::filesystem::path& bag);

/// Returns the points in the body at their own times, in order of time. `t_ns`: time of the message
/// by the clock that is used. Adds to `left_out` points that are not finite or at the sensor's
/// place; a twentieth may be further than 1000 m away. InputError: x, y or z is missing, a field is
/// missing, the layout does not fit the data.
std::vector<LidarPoint> parse_scan(const PointCloud& cloud, const ScanFields& fields,
                                   std::int64_t t_ns, const Rigid3d& body_from_lidar,
                                   const std::filesystem::path& file, std::size_t* left_out);

}  // namespace redrive::rosbag
