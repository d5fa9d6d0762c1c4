// SPDX-License-Identifier: Apache-2.0
// A run's poses may be off by errors of the egomotion or free after refinement; the truth stands in
// its own frame. Before a picture is compared with the truth of its place, the two trajectories are
// laid over each other.
#pragma once

#include <span>

#include "redrive/recording/recording.h"

namespace redrive {

struct TrajectoryRegistration {
  Rigid3d run_from_ground_truth =
      Rigid3d::Identity();  ///< ECEF to ECEF: where the run would put a true pose
  int frames = 0;           ///< that both trajectories have
  double translation_m = 0, rotation_deg = 0;  ///< of the trajectory's middle by that motion
  double residual_m = 0,
         residual_deg = 0;  ///< RMS of position and rotation that no rigid motion explains
};

/// Least squares (Umeyama 1991, no scale) over the bodies' origins and points 30 m from them along
/// each axis, so that the rotation is held on a straight road, too. Frames are paired by id;
/// InputError (`file` is the true trajectory's) if there is no pair.
TrajectoryRegistration register_trajectories(std::span<const FramePose> run,
                                             std::span<const FramePose> truth,
                                             const std::filesystem::path& file);

}  // namespace redrive
