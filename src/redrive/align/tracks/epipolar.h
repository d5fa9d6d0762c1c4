// SPDX-License-Identifier: Apache-2.0
// What two images of one static scene have to agree in, whatever its depth: rays to a point and the
// way between the cameras lie in a plane. In pixels, for any camera model.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/tracks/tracks.h"
#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// One point in two images: unit rays in the cameras' axes, and pixels per radian around them.
struct RayPair {
  Eigen::Vector3d ray_a, ray_b;
  double px_per_rad_a = 1, px_per_rad_b = 1;
};
/// Nothing where a camera's model does not reach.
std::optional<RayPair> make_ray_pair(const Camera& a, const Eigen::Vector2d& pixel_a,
                                     const Camera& b, const Eigen::Vector2d& pixel_b);

/// Sampson's distance: e / sigma_e, e = ray_b . (t x R ray_a), where sigma_e is e's standard
/// deviation if each pixel coordinate's is 1 px. Pixels; does not depend on the length of t. 0 for
/// t = 0.
double sampson_error_px(const RayPair& pair, const Rigid3d& b_from_a);

/// How far along ray_a the point is that both unit rays lead to, in the unit of b_from_a's
/// translation. Nothing where they are parallel to 0.01 rad or it lies behind.
std::optional<double> ray_depth(const Eigen::Vector3d& ray_a, const Eigen::Vector3d& ray_b,
                                const Rigid3d& b_from_a);

/// The relative pose that most pairs agree with: a local minimum of sum of log(1 + (error / 1
/// px)^2), the best of those reached from the starts with errors' scale going down from 16 px to 1
/// px. Its translation is a unit vector: pixels say nothing of its length. Nothing of less than 12
/// pairs. From a start 2 degrees off, a quarter of outliers at 30 px may lead it astray.
std::optional<Rigid3d> fit_relative_pose(const std::vector<RayPair>& pairs,
                                         const std::vector<Rigid3d>& starts);

}  // namespace redrive
