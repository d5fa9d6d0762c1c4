// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/pcd.h"

#include "redrive/recording/parse/little_endian.h"

namespace redrive {

std::string make_pcd(std::span<const LidarRecord> points) {
  const std::string n = std::to_string(points.size());
  std::string bytes =
      "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 8\n"
      "TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH " +
      n + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + n + "\nDATA binary\n";
  for (const LidarRecord& point : points) {
    for (const double coordinate : point.position_m)
      add_bytes(static_cast<float>(coordinate), &bytes);
    add_bytes(1e-9 * static_cast<double>(point.t_ns), &bytes);
  }
  return bytes;
}

}  // namespace redrive
