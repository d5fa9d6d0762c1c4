// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/scan_files.h"

#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/recording/laz_decoder.h"
#include "redrive/recording/little_endian.h"

namespace redrive {
namespace {

void add_position(const ScanPoint& point, std::string* bytes) {
  for (const double coordinate : point.position_m) add_bytes(static_cast<float>(coordinate), bytes);
}

constexpr double kLasStep_m = 1e-4;
constexpr std::size_t kLas12HeaderBytes = 227;

template <class T>
void put(T value, std::size_t offset, std::string* bytes) {
  std::memcpy(bytes->data() + offset, &value, sizeof value);
}

std::string las_header(std::uint32_t points, const Eigen::Vector3d& least,
                       const Eigen::Vector3d& most) {
  std::string header(kLas12HeaderBytes, '\0');
  header.replace(0, 4, "LASF");
  header[24] = 1, header[25] = 2;  // version 1.2
  header.replace(26, 7, "redrive");
  header.replace(58, 7, "redrive");
  put(static_cast<std::uint16_t>(kLas12HeaderBytes), 94, &header);
  put(static_cast<std::uint32_t>(kLas12HeaderBytes), 96, &header);  // offset of the points
  header[104] = 1;                                                  // point format
  put(static_cast<std::uint16_t>(kLasRecordBytes), 105, &header);
  put(points, 107, &header);
  put(points, 111, &header);  // first returns
  for (int axis = 0; axis < 3; ++axis) {
    const std::size_t k = axis;
    put(kLasStep_m, 131 + 8 * k, &header);
    put(most[axis], 179 + 16 * k, &header);
    put(least[axis], 187 + 16 * k, &header);
  }
  return header;
}

}  // namespace

std::string make_las(std::span<const ScanPoint> points) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  Eigen::Vector3d least = Eigen::Vector3d::Constant(kNone), most = -least;
  for (const ScanPoint& point : points) {
    least = least.cwiseMin(point.position_m);
    most = most.cwiseMax(point.position_m);
  }
  if (points.empty()) least = most = Eigen::Vector3d::Zero();
  REDRIVE_CHECK(least.minCoeff() >= -kMaxLasPosition_m && most.maxCoeff() <= kMaxLasPosition_m);
  REDRIVE_CHECK_OP(points.size(), <=, std::numeric_limits<std::uint32_t>::max());
  std::string bytes = las_header(static_cast<std::uint32_t>(points.size()), least, most);
  bytes.reserve(bytes.size() + kLasRecordBytes * points.size());
  for (const ScanPoint& point : points) {
    for (const double coordinate : point.position_m)
      add_bytes(static_cast<std::int32_t>(std::lround(coordinate / kLasStep_m)), &bytes);
    add_bytes(point.intensity, &bytes);
    add_bytes(std::uint8_t{011}, &bytes);  // the first return of one
    add_bytes(std::uint8_t{0}, &bytes);    // classification: never classified
    add_bytes(std::uint32_t{0}, &bytes);   // scan angle, user data, source
    add_bytes(static_cast<double>(point.t_ns), &bytes);
  }
  return bytes;
}

std::string make_pcd(std::span<const ScanPoint> points) {
  const std::string n = std::to_string(points.size());
  std::string bytes =
      "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 8\n"
      "TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH " +
      n + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + n + "\nDATA binary\n";
  for (const ScanPoint& point : points) {
    add_position(point, &bytes);
    add_bytes(1e-9 * static_cast<double>(point.t_ns), &bytes);
  }
  return bytes;
}

std::string make_kitti_scan(std::span<const ScanPoint> points) {
  std::string bytes;
  for (const ScanPoint& point : points) {
    add_position(point, &bytes);
    add_bytes(0.0f, &bytes);
  }
  return bytes;
}

std::string kitti_timestamp(std::int64_t t_ns) {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  const std::int64_t fraction_ns = (t_ns % kSecond_ns + kSecond_ns) % kSecond_ns;
  const std::time_t seconds = (t_ns - fraction_ns) / kSecond_ns;
  std::tm day{};
  ::gmtime_r(&seconds, &day);
  char text[64];
  const std::size_t length = std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &day);
  std::snprintf(text + length, sizeof text - length, ".%09d", static_cast<int>(fraction_ns));
  return text;
}

}  // namespace redrive
