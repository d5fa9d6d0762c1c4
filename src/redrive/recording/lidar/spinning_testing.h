// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/math/angles.h"
#include "redrive/recording/lidar/scan_structure.h"

namespace redrive {

/// A LiDAR of 16 beams, 2 degrees apart and in four columns of azimuths, that turns at `rate_hz`
/// with 900 firings a turn. Packets of three firings share a time.
struct Spinning {
  double rate_hz = 10, lost = 0.1, second = 0.2, noise_rad = 0;
  bool clockwise = true, has_rings = false, has_times = true;
  double jitter = 0;  ///< noise of azimuths, steps
  Rigid3d body_from_lidar = Eigen::Translation3d(1, 0.2, 1.7) *
                            Rigid3d(Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 2) / 3));

  static constexpr int kBeams = 16, kSteps = 900;
  static double elevation_rad(int beam) { return kRadiansPerDegree * (2 * beam - 20); }
  static double azimuth_rad(int beam) { return kRadiansPerDegree * (2 * (beam % 4) - 3); }

  /// `lost_rays`: gets the directions of the lost rays, in the sensor's axes.
  std::vector<LidarPoint> scan(int number,
                               std::vector<Eigen::Vector3d>* lost_rays = nullptr) const {
    std::vector<LidarPoint> points;
    std::uint64_t drawn = 1'000'000u * static_cast<std::uint64_t>(number);
    const auto random = [&] { return static_cast<double>(mix64(++drawn) >> 11) * 0x1p-53; };
    for (int step = 0; step < kSteps; ++step)
      for (int beam = 0; beam < kBeams; ++beam) {
        const double jittered = step + 0.5 + (jitter > 0 ? jitter * (random() - 0.5) : 0),
                     turn = 2 * std::numbers::pi * jittered / kSteps + number,
                     azimuth = azimuth_rad(beam) + (clockwise ? -turn : turn),
                     elevation = elevation_rad(beam) + noise_rad * (random() - 0.5);
        const Eigen::Vector3d direction = beam_direction(elevation, azimuth);
        if (random() < lost) {
          if (lost_rays) lost_rays->push_back(direction);
          continue;
        }
        for (const double range_m : {5 + 20 * random(), random() < second ? 30.0 : 0.0})
          if (range_m > 0)
            points.push_back(
                {.in_body_m =
                     (body_from_lidar * Eigen::Vector3d(range_m * direction)).cast<float>(),
                 .ring = static_cast<std::uint8_t>(has_rings ? kBeams - 1 - beam : kNoRing),
                 .t_ns = has_times
                             ? std::llround(1e9 * (number + step / 3 * 3.0 / kSteps) / rate_hz)
                             : 0});
      }
    return points;
  }
  std::optional<ScanStructure> estimate(std::string* why) const {
    const std::vector<std::vector<LidarPoint>> scans = {scan(0), scan(1)};
    return estimate_structure(scans, body_from_lidar, why);
  }
};

}  // namespace redrive
