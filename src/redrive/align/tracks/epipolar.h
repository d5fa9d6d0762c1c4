// SPDX-License-Identifier: Apache-2.0
// Epipolar geometry of two images of a static scene, in pixels, for any camera model: the rays to a
// point and the baseline lie in one plane.
#pragma once

#include <optional>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// One point in two images: unit rays in the cameras' axes, and pixels per radian around them.
struct RayPair {
  Eigen::Vector3d ray_a, ray_b;
  double px_per_rad_a = 1, px_per_rad_b = 1;
};
/// Nothing outside the valid region of a camera model.
std::optional<RayPair> make_ray_pair(const Camera& a, const Eigen::Vector2d& pixel_a,
                                     const Camera& b, const Eigen::Vector2d& pixel_b);

/// Sampson's distance: e / sigma_e, e = ray_b . (t x R ray_a), where sigma_e is e's standard
/// deviation if each pixel coordinate's is 1 px. Pixels; does not depend on the length of t. 0 for
/// t = 0.
double sampson_error_px(const RayPair& pair, const Rigid3d& b_from_a);

/// Depth along ray_a of the point that both unit rays meet in, in the unit of b_from_a's
/// translation. Nothing where the rays are parallel to 0.01 rad or the point lies behind.
std::optional<double> ray_depth(const Eigen::Vector3d& ray_a, const Eigen::Vector3d& ray_b,
                                const Rigid3d& b_from_a);

/// The relative pose that most pairs agree with: the lowest local minimum of the sum of log(1 +
/// (error / 1 px)^2) reached from the starts, with the scale of errors decreasing from 16 px to 1
/// px. Its translation is a unit vector, since its length is unobservable. Nothing for fewer than
/// 12 pairs. From a start 2 degrees off, a quarter of outliers at 30 px may lead to another
/// minimum.
std::optional<Rigid3d> fit_relative_pose(const std::vector<RayPair>& pairs,
                                         const std::vector<Rigid3d>& starts);

}  // namespace redrive
