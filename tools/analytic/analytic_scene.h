// SPDX-License-Identifier: Apache-2.0
// A courtyard that is a handful of formulas: a textured ground plane, boxes and spheres under a sun
// and a sky. Every pixel's colour and depth is the closest root of a plane, slab or quadratic
// equation. World axes: x forward, y left, z up, metres; the ground is z = 0.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace redrive::analytic {

enum class Texture { kAsphalt, kBrick, kFacade, kChecker, kStripes, kMetal };

struct Box {
  Eigen::Vector3d low, high;  ///< axis-aligned corners
  Texture texture;
  Eigen::Vector3d colour, second_colour;  ///< linear RGB in [0, 1]
};

struct Sphere {
  Eigen::Vector3d center;
  double radius;
  Texture texture;
  Eigen::Vector3d colour, second_colour;
};

struct Courtyard {
  std::vector<Box> boxes;
  std::vector<Sphere> spheres;
  Eigen::Vector3d to_sun;  ///< unit
};

/// The scene that ships; `seed` moves crates and balls and draws their colours.
Courtyard make_courtyard(unsigned seed);

/// Colour and distance along a ray.
struct RayColour {
  Eigen::Vector3d colour;  ///< display-referred sRGB in [0, 1]
  double distance_m;       ///< along the ray; 0 for the sky
};

/// Traces a ray of unit direction.
RayColour trace(const Courtyard& scene, const Eigen::Vector3d& origin,
                const Eigen::Vector3d& direction);

}  // namespace redrive::analytic
