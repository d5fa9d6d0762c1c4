// SPDX-License-Identifier: Apache-2.0
// Where the point of a track is, as far as the poses of now say.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// When observations were exposed: of cameras without a rolling shutter computed once for all of an
/// image. `model` has to outlive it and to stay as it is.
class ExposureMotions {
 public:
  explicit ExposureMotions(const RigModel& model);
  Instant of(const Observation& seen) const;

 private:
  const RigModel& model_;
  std::vector<std::vector<Instant>> instants_;  ///< by camera and frame
};

/// The point that robustly (Cauchy, sigma_px[camera] by 2) explains the observations:
/// Levenberg-Marquardt from the best of several distances along the ray of the observation in the
/// middle. Nothing where that has no ray or the point would lie behind infinity.
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
