// SPDX-License-Identifier: Apache-2.0
// Triangulates tracks with known poses: a linear start, then Gauss-Newton on reprojection errors.
#pragma once

#include <optional>
#include <span>

#include "redrive/align/tracks/tracks.h"
#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

struct TriangulateOptions {
  double min_angle_rad = 0.005;  ///< between the two most different rays; below, there is no depth
  double outlier_px = 3;         ///< scale of the robust loss
};

/// Projection minus observation, pixels; nothing where the camera does not see the point.
std::optional<Eigen::Vector2d> reprojection_residual(const Eigen::Vector3d& in_world,
                                                     const Observation& observation,
                                                     const Rigid3d& world_from_camera,
                                                     const Camera& camera);

/// The point of `track` in the world, metres. world_from_camera[i] belongs to track.seen[i],
/// cameras[c] to camera c of the recording. Minimises sum rho(|residual|), rho the Geman-McClure
/// function with the scale outlier_px, from the best of several starts, so that less than half of
/// three or more observations may be outliers. Nothing: parallax below min_angle_rad, the point
/// behind a camera, or fewer than two observations within outlier_px (of two observations both, of
/// more at least half).
std::optional<Eigen::Vector3d> triangulate(const Track& track,
                                           std::span<const Rigid3d> world_from_camera,
                                           std::span<const Camera> cameras,
                                           const TriangulateOptions& options = {});

}  // namespace redrive
