// SPDX-License-Identifier: Apache-2.0
// Finds the places of LiDAR returns through which rays of other times passed.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// A return above the ground, one of each kThinning_m of a scan.
struct SweepPoint {
  Eigen::Vector3f in_world = Eigen::Vector3f::Zero(), sensor_in_world = Eigen::Vector3f::Zero();
  std::int64_t t_ns = 0;
  float ground_m = 0;  ///< z of the ground below it
  /// Numbers of scans at other times that have a ray through it and none that ends at it (through),
  /// and that have one that ends at it (ended). Counting stops once it is clear whether it vanishes
  /// or stays.
  int through = 0, ended = 0;
  bool vanishes() const { return through >= 2 && 4 * ended <= through; }
  bool stays() const { return ended > through; }
};

/// Returns of a tenth of a second.
struct Sweep {
  std::vector<SweepPoint> points;  ///< 0.3 m to 3.5 m above the ground, at most 60 m away
};

constexpr double kSweep_s = 0.1;
constexpr float kThinning_m = 0.25f;

/// Maximum bytes of seen_through for this many returns in this many scans.
std::uint64_t search_bytes(std::uint64_t returns, std::uint64_t revolutions);

/// Returns how often seen_through looks from one of so many sweeps at another, at most. Most points
/// stay in place, which half of the looks tell.
std::int64_t search_looks(std::int64_t sweeps);

/// Returns scans one after the other, empty ones included; none where they span more than a day.
/// Scans nearer than 0.4 s to one do not count for it.
std::vector<Sweep> seen_through(const Scene& scene, const LidarReturns& returns, ThreadPool& pool);

}  // namespace redrive
