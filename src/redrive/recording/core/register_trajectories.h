// SPDX-License-Identifier: Apache-2.0
// Registers a run's trajectory with the ground truth. Initial poses carry errors of the egomotion,
// and refinement leaves their frame of reference free, so images of a run are compared with ground
// truth only after this registration.
#pragma once

#include <span>

#include <nlohmann/json_fwd.hpp>

#include "redrive/recording/core/recording.h"

namespace redrive {

struct TrajectoryRegistration {
  Rigid3d run_from_ground_truth = Rigid3d::Identity();  ///< ECEF to ECEF: maps ground-truth poses
                                                        ///< to the run's frame of reference
  int frames = 0;                                       ///< number of frames in both trajectories
  double translation_m = 0, rotation_deg = 0;  ///< size of that motion, at the trajectory's middle
  double residual_m = 0,
         residual_deg = 0;  ///< RMS of position and rotation that no rigid motion explains
};

/// Computes the least-squares motion (Umeyama 1991, no scale) over the bodies' origins and points
/// 30 m from them along each axis, so that a straight drive determines the rotation, too. Frames
/// are paired by id; throws InputError naming `file`, the ground truth's, if there is no pair.
TrajectoryRegistration register_trajectories(std::span<const FramePose> run,
                                             std::span<const FramePose> ground_truth,
                                             const std::filesystem::path& file);

/// Returns translation_m, rotation_deg, residual_m, residual_deg and frames.
nlohmann::json registration_to_json(const TrajectoryRegistration& registration);

}  // namespace redrive
