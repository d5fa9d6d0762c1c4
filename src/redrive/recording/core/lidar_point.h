// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

namespace redrive {

/// LidarPoint::ring where the format gives none.
constexpr std::uint8_t kNoRing = 255;

/// A LiDAR return, not motion compensated: in the body frame at the point's own time.
struct LidarPoint {
  Eigen::Vector3f in_body_m;    ///< |coordinate| <= 1e4: exact to 0.5 mm, to 8 um within 128 m
  std::uint16_t intensity = 0;  ///< 0..intensity_scale; fractions of a file are of 65535
  std::uint8_t ring = kNoRing;  ///< number of its beam, in any order
  std::int64_t t_ns = 0;        ///< host clock
};

/// Full scale of a recording's intensities by the largest of them: formats have 8 bits or 16.
constexpr std::uint16_t intensity_scale(std::uint16_t largest) {
  return largest <= 255 ? 255 : 65535;
}

/// LidarRecord::actor of the static world.
constexpr std::int32_t kNoActor = std::numeric_limits<std::int32_t>::min();

/// A LiDAR point of a file to be written, in the axes of that file.
struct LidarRecord {
  Eigen::Vector3d position_m;
  std::int64_t t_ns = 0;
  float intensity = 0;  ///< 0..1 of the full scale
  std::uint8_t ring = kNoRing;
  float azimuth_rad = 0;          ///< azimuth of its ray, to the left of the sensor's heading
  float range_m = 0;              ///< from the sensor
  std::int32_t actor = kNoActor;  ///< id of the moving object that it is on
  float loss = 0;                 ///< probability that its ray has no return
};

/// Returns an intensity of 0..1 in the 16 bits of files and LidarPoint.
inline std::uint16_t intensity_in_16_bits(float intensity) {
  return static_cast<std::uint16_t>(std::lround(65535 * std::clamp(intensity, 0.0f, 1.0f)));
}

/// Middle of the times of the points; nothing without points.
inline std::optional<std::int64_t> middle_ns(std::span<const LidarPoint> points) {
  if (points.empty()) return std::nullopt;
  const auto [first, last] = std::ranges::minmax_element(points, {}, &LidarPoint::t_ns);
  return first->t_ns + (last->t_ns - first->t_ns) / 2;
}

}  // namespace redrive
