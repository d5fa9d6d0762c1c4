// SPDX-License-Identifier: Apache-2.0
// Where the point of a track is, as far as the poses of now say.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/rig_model.h"
#include "redrive/align/terms.h"
#include "redrive/align/tracks.h"

namespace redrive {

/// By camera and frame: computed once for all tracks of a round.
class ImageTimes {
 public:
  explicit ImageTimes(const RigModel& model);
  const Instant& of(const Observation& seen) const { return instants_[seen.camera][seen.frame]; }

 private:
  std::vector<std::vector<Instant>> instants_;
};

/// The point that robustly (Cauchy, sigma_px[camera] by 2) explains the observations: Levenberg-Marquardt from the best of several
/// distances along the ray of the observation in the middle. Nothing where that has no ray or the point would lie behind infinity.
std::optional<InverseDistancePoint> locate_point(const RigModel& model, const ImageTimes& times, const Track& track,
                                                 const std::vector<double>& sigma_px);

/// Projection minus pixel of each observation, pixels; kUnseen where a camera does not see the point.
std::vector<Eigen::Vector2d> reprojection_errors(const RigModel& model, const ImageTimes& times, const Track& track,
                                                 const InverseDistancePoint& point);

}  // namespace redrive
