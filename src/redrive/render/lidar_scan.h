// SPDX-License-Identifier: Apache-2.0
// LiDAR scans of a model, as a sensor on the moving car records them.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "redrive/model/field.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/render/view_pose.h"

namespace redrive {

/// A ray of a lower opacity, or probability of a return, has none. From 0.4 to 0.5 as many rays are
/// lost or returned as recorded; at 0.4 fewer returns are missing (docs/experiments.md).
constexpr float kMinReturnOpacity = 0.4f;

/// Default limits of a return's range, metres.
constexpr double kMinReturn_m = 0.5, kMaxReturn_m = 200;

/// The motion of a sensor: on the body along the trajectory, shifted along `axes` (kCamera: the
/// sensor's own, x forward, y left, z up). The scene must outlive it.
struct SensorMotion {
  const Scene& scene;
  Rigid3d body_from_sensor = Rigid3d::Identity();
  ShiftAxes axes = ShiftAxes::kBody;
  Eigen::Vector3d shift_m = Eigen::Vector3d::Zero();

  Rigid3d world_from_body(std::int64_t t_ns) const;
  /// UsageError where `axes` do not exist (view_pose.h shifted_camera).
  Rigid3d world_from_sensor(std::int64_t t_ns) const;
};

/// The axes of a scan's points: the sensor's or the body's at the time of each point, or the world
/// of the scene, where points are motion compensated.
enum class PointAxes { kSensor, kBody, kWorld };

struct ScanOptions {
  double min_range_m = kMinReturn_m, max_range_m = kMaxReturn_m;
  PointAxes axes = PointAxes::kSensor;
  float gain = 1;                         ///< factor of intensities (RecordedLidar::gain)
  std::vector<BeamGain> beam_gains = {};  ///< more of them, by LidarFirings::ring
  BlindDirections blind = {};             ///< rays that the vehicle stops are lost
  /// draws rays with a return by their probability; nothing: kMinReturnOpacity decides
  std::optional<std::uint64_t> seed;
};

struct LidarScan {
  std::vector<LidarRecord> points;         ///< as the firings; intensity 0 where the field has none
  std::vector<std::uint32_t> firing;       ///< index of the firing of each point
  std::size_t lost = 0, out_of_range = 0;  ///< firings without a return, by reason
  bool has_intensity = false;              ///< whether the field models it
};

/// Fires along the motion: each ray starts where the sensor is at its time, and meets the moving
/// objects of motion.scene where they are then. A ray is lost where the field is transparent, or
/// with the probability that the field gives, if that is higher.
LidarScan render_scan(kernels::Backend& backend, const Field& model, const LidarFirings& firings,
                      const SensorMotion& motion, const ScanOptions& options);

/// Returns the axes of a LiDAR (x forward, y left, z up) in the axes of a camera that looks ahead.
Rigid3d camera_from_lidar_axes();

}  // namespace redrive
