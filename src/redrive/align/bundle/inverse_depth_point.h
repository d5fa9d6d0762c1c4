// SPDX-License-Identifier: Apache-2.0
// Triangulates tracks with the present poses of the rig model.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// The motion of the rig at the exposure of each observation. For cameras without a rolling shutter
/// it is computed once an image. `model` has to outlive it unchanged.
class ExposureMotions {
 public:
  explicit ExposureMotions(const RigModel& model);
  LocalMotion of(const Observation& seen) const;

 private:
  const RigModel& model_;
  std::vector<std::vector<LocalMotion>> motions_;  ///< [camera][frame]
};

/// The point that minimises the reprojection errors under a Cauchy loss of 2 sigma_px[camera]:
/// Levenberg-Marquardt from the best of several depths along the ray of the middle observation.
/// Nothing where that pixel has no ray or the point would lie behind infinity.
std::optional<InverseDepthPoint> fit_inverse_depth_point(const RigModel& model,
                                                         const ExposureMotions& times,
                                                         const Track& track,
                                                         const std::vector<double>& sigma_px);

/// Projection minus pixel of each observation, pixels; kUnseen where a camera does not see the
/// point.
std::vector<Eigen::Vector2d> reprojection_errors(const RigModel& model,
                                                 const ExposureMotions& times, const Track& track,
                                                 const InverseDepthPoint& point);

}  // namespace redrive
