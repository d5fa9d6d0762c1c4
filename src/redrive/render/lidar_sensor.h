// SPDX-License-Identifier: Apache-2.0
// LiDAR sensors to simulate: when and in which directions they fire during a revolution.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/camera/mount.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Pulses of a revolution, by time.
struct LidarFirings {
  std::vector<Eigen::Vector3d> direction;  ///< unit, in axes of the sensor: x forward, y left, z up
  std::vector<std::int64_t> t_ns;

  std::size_t size() const { return t_ns.size(); }
};

/// A spinning LiDAR. All its beams fire together at each azimuth step.
struct SpinningLidar {
  std::vector<double> elevation_deg;  ///< elevations of the beams, upwards
  int azimuth_steps = 1800;           ///< firings in a revolution
  double rate_hz = 10;                ///< revolutions a second

  /// Returns a revolution that begins behind, turns clockwise seen from above and looks ahead at
  /// t_ns, like KITTI's.
  LidarFirings revolution(std::int64_t t_ns) const;
};

/// Parses the elevations of beams: "N", as common sensors with N beams have them, "N:MIN:MAX",
/// evenly spaced, or "E1,E2,..", degrees. A single elevation has a point or a sign: "5.0". Nothing
/// unless there are 1 to 256 (for N and N:MIN:MAX at least 2, MIN < MAX) within -90..90.
std::optional<std::vector<double>> parse_beams(std::string_view text);
/// Rule of that text, for error messages.
inline constexpr const char* kBeamsRule =
    "must be recorded, N beams, N:MIN:MAX (N beams from MIN to MAX degrees) or elevations E1,E2,.. "
    "in degrees; at most 256 within -90..90, e.g. 64 or 64:-24.8:2";

/// Returns the firings of the recorded revolution of a frame: firings with a recorded return,
/// without returns on the vehicle itself; of several revolutions the one whose middle is nearest to
/// the frame. Nothing where the recording has no revolution or no pose of the frame, or none of the
/// points has a pose. Axes are those that Recording::body_from_lidar describes, which must be
/// known. InputError for a damaged file.
std::optional<LidarFirings> recorded_firings(const Recording& recording, const Scene& scene,
                                             std::int64_t frame_id, ThreadPool& pool);

/// Returns the axes of a LiDAR (x forward, y left, z up) in the axes of a camera that looks ahead.
Rigid3d camera_from_lidar_axes();

}  // namespace redrive
