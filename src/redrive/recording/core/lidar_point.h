// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>

#include <Eigen/Core>

namespace redrive {

/// LidarPoint::ring where the format gives none.
constexpr std::uint8_t kNoRing = 255;

/// A LiDAR return, not motion compensated: in the body frame at the point's own time.
struct LidarPoint {
  Eigen::Vector3f in_body_m;    ///< |coordinate| <= 1e4: exact to 0.5 mm, to 8 um within 128 m
  std::uint16_t intensity = 0;  ///< on the sensor's own scale; fractions are scaled to 0..255
  std::uint8_t ring = kNoRing;  ///< number of its beam, in any order
  std::int64_t t_ns = 0;        ///< host clock
};

/// A LiDAR point of a file to be written, in the axes of that file.
struct LidarRecord {
  Eigen::Vector3d position_m;
  std::int64_t t_ns = 0;
  std::uint16_t intensity = 0;
};

/// Middle of the times of the points; nothing without points.
inline std::optional<std::int64_t> middle_ns(std::span<const LidarPoint> points) {
  if (points.empty()) return std::nullopt;
  const auto [first, last] = std::ranges::minmax_element(points, {}, &LidarPoint::t_ns);
  return first->t_ns + (last->t_ns - first->t_ns) / 2;
}

}  // namespace redrive
