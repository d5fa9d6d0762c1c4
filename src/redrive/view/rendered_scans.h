// SPDX-License-Identifier: Apache-2.0
// LiDAR scans of a run's field, for the points over its images.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/train/run.h"
#include "redrive/view/server/messages.h"

namespace redrive::view {

/// Maximum number of rays of a scan; of more, every n-th is fired, since images wait meanwhile.
constexpr std::size_t kMostRays = 1 << 18;
constexpr std::size_t kMostMarchedRays = 1 << 13;  ///< likewise, where a method marches along rays

/// Returns the colour of a range by its logarithm: 0, which pages show red, up to 1 m, and 255,
/// which they show blue, from 100 m.
std::uint8_t range_colour(double range_m);

/// The returns of a scan.
struct RenderedScan {
  ScanRequest request;
  std::int64_t frame = 0;
  std::vector<Eigen::Vector3f> in_world;  ///< metres
  /// Colour of each point: range_colour; of an intensity by its root, 255 of 0; of the error of a
  /// range by its logarithm, 255 up to 1 cm, 0 from 1 m and for recorded returns that are lost,
  /// which are where they were recorded.
  std::vector<std::uint8_t> colour;
  /// {"rays", "returns", "error_m": null or the median error of the ranges against the recorded}
  nlohmann::json described;
};

class RenderedScans {
 public:
  /// Both must outlive it.
  RenderedScans(const Run& run, kernels::Backend& backend) : run_(run), backend_(backend) {}

  /// Returns the names of the sensors that a page offers; none without a field or a LiDAR's place.
  std::vector<std::string> sensors() const;

  /// Makes `scan` the requested one of a frame, unless it is already. `traffic`: has the moving
  /// objects of a new scan. InputError for a damaged file, and where the run has no such scan.
  void update(const ScanRequest& request, std::int64_t frame, const Scene& traffic,
              std::optional<RenderedScan>* scan);

 private:
  const LidarSensor& estimated();
  LidarFirings firings(const ScanRequest& request, std::int64_t frame, std::int64_t t_ns,
                       double* max_range_m);

  const Run& run_;
  kernels::Backend& backend_;
  std::optional<LidarSensor> estimated_;
  std::string not_estimated_;  ///< why; empty: not tried
};

}  // namespace redrive::view
