// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_files.h"

#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

/// A field of both formats, as add_point writes it.
struct ScanField {
  const char *name, *ply_type;
  int bytes;
  char pcd_type;
};
constexpr ScanField kScanFields[] = {{"x", "float", 4, 'F'},     {"y", "float", 4, 'F'},
                                     {"z", "float", 4, 'F'},     {"intensity", "float", 4, 'F'},
                                     {"ring", "uchar", 1, 'U'},  {"time", "double", 8, 'F'},
                                     {"range", "float", 4, 'F'}, {"azimuth", "float", 4, 'F'},
                                     {"actor", "int", 4, 'I'},   {"loss", "float", 4, 'F'}};

void add_point(const LidarRecord& point, std::string* bytes) {
  for (const double coordinate : point.position_m) add_bytes(static_cast<float>(coordinate), bytes);
  add_bytes(point.intensity, bytes);
  add_bytes(point.ring, bytes);
  add_bytes(1e-9 * static_cast<double>(point.t_ns), bytes);
  add_bytes(point.range_m, bytes);
  add_bytes(point.azimuth_rad, bytes);
  add_bytes(point.actor, bytes);
  add_bytes(point.loss, bytes);
}

}  // namespace

std::string make_pcd(std::span<const LidarRecord> points) {
  std::string fields, sizes, types, counts;
  for (const ScanField& field : kScanFields) {
    fields += std::string(" ") + field.name;
    sizes += " " + std::to_string(field.bytes);
    types += std::string(" ") + field.pcd_type;
    counts += " 1";
  }
  const std::string n = std::to_string(points.size());
  std::string bytes = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS" + fields +
                      "\nSIZE" + sizes + "\nTYPE" + types + "\nCOUNT" + counts + "\nWIDTH " + n +
                      "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + n + "\nDATA binary\n";
  for (const LidarRecord& point : points) add_point(point, &bytes);
  return bytes;
}

std::string make_scan_ply(std::span<const LidarRecord> points) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                      std::to_string(points.size()) + "\n";
  for (const ScanField& field : kScanFields)
    bytes += std::string("property ") + field.ply_type + " " + field.name + "\n";
  bytes += "end_header\n";
  for (const LidarRecord& point : points) add_point(point, &bytes);
  return bytes;
}

}  // namespace redrive
