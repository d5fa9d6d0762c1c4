// SPDX-License-Identifier: Apache-2.0
// The LiDAR of a drive as rays in the world of the scene: each point where the body was at the
// point's own time, so that the revolutions are motion compensated. They are known to be free up to
// `range_m` and to end there.
//
// All revolutions of the scene's frames are used, also those of held-out frames: what is held out
// is their pictures.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Structure of arrays, as RayBatch; float is exact to 0.1 mm within 1 km of the first frame.
struct LidarReturns {
  std::size_t n = 0;
  std::vector<float> origin;             ///< [3, n] metres in the world: where the sensor was
  std::vector<float> direction;          ///< [3, n] unit, in the world
  std::vector<float> range_m;            ///< [n] > 0: the return is at origin + range_m direction
  std::vector<std::int64_t> t_ns;        ///< [n] host clock, as the points lie in their files
  std::vector<std::uint16_t> intensity;  ///< [n] of the sensor's own scale; a cloud has none: 0

  // Points left out, each counted under the first reason that holds.
  std::size_t repeated = 0;           ///< in the file before, too: neighbouring revolutions overlap
  std::size_t beyond_trajectory = 0;  ///< more than 60 ms before the first or after the last pose
  std::size_t on_ego = 0;             ///< on the recording vehicle itself
  std::size_t on_moving = 0;          ///< inside the box of an annotated object that moves
  std::size_t hidden = 0;             ///< of a cloud: cloud_returns.h
};

/// Returns of the revolutions whose frame id lies within those of scene.frames; of a recording that
/// has a points_file instead, its cloud_returns. None where there is neither or the recording does
/// not say where its LiDAR stands (Recording::body_from_lidar). InputError as read_las and
/// read_ply.
LidarReturns load_lidar_returns(const Recording& recording, const Scene& scene,
                                const MovingObjects& moving, ThreadPool& pool);

}  // namespace redrive
