// SPDX-License-Identifier: Apache-2.0
// Scans of a run by any sensor, asked for as `redrive render lidar` does.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "redrive/render/lidar_scan.h"
#include "redrive/train/run.h"

namespace redrive {

/// Options by their names on the command line; errors name them.
struct LidarOptions {
  std::string sensor = "recorded";    ///< recorded, estimated, or as parse_lidar_sensor
  std::string lidar;                  ///< the recorded one that is meant; empty: the first
  std::string mount;                  ///< parse_mount; empty: that LiDAR's
  std::string range;                  ///< "MIN:MAX" metres; empty: the sensor's
  std::string points_in = "sensor";   ///< sensor, body or world
  std::optional<int> azimuth_steps;   ///< firings in a turn; nothing: the sensor's own
  std::optional<double> rate_hz;      ///< likewise
  std::optional<std::uint64_t> seed;  ///< ScanOptions::seed
};

constexpr double kMaxLidarRange_m = 1e4;

/// Checked options. They become a sensor of a run by complete_sensor.
struct LidarRequest {
  LidarOptions options;
  bool recorded = false;              ///< the recorded revolutions
  std::optional<LidarSensor> sensor;  ///< nothing: the recording's, to be estimated
  std::optional<Mount> mount;
  ScanOptions scan;

  bool is_of_recording() const { return recorded || !sensor; }
};

/// UsageError.
LidarRequest parse_lidar_request(const LidarOptions& options);

/// Returns the index in Recording::lidars of the recorded LiDAR that is meant. UsageError.
std::size_t lidar_index(const LidarRequest& request, const Recording& recording);

/// Estimates the recording's LiDAR where it is requested, and applies the options of a sensor.
/// Returns whether it estimated. UsageError where it cannot.
bool complete_sensor(const Recording& recording, LidarRequest* request);

/// Returns the motion of the requested sensor in `scene`, whose moving objects it will meet. The
/// scene must outlive it. UsageError where the recording has no LiDAR and the request no mount, or
/// is of photographs.
SensorMotion sensor_motion(const LidarRequest& request, const Recording& recording,
                           const Scene& scene, const SensorShift& shift);

/// Returns the firings of the revolution of a frame; nothing where the recording has none.
std::optional<LidarFirings> firings_of(const LidarRequest& request, const Recording& recording,
                                       const Scene& scene, std::int64_t frame_id,
                                       std::int64_t frame_ns, ThreadPool& pool);

}  // namespace redrive
