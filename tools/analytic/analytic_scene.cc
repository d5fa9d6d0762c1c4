// SPDX-License-Identifier: Apache-2.0
#include "tools/analytic/analytic_scene.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "redrive/base/rng.h"

namespace redrive::analytic {
namespace {

using Eigen::Vector3d;

constexpr double kRayStart = 1e-6;  // metres: a shadow ray must not hit the surface it starts from

struct Hit {
  double t = std::numeric_limits<double>::infinity();
  Vector3d normal = Vector3d::UnitZ();
  Texture texture = Texture::kAsphalt;
  Vector3d colour = Vector3d::Constant(0.3), second_colour = Vector3d::Constant(0.3);
  Vector3d local = Vector3d::Zero();  // where the texture is looked up
};

// Value noise: random values on the integer lattice, smoothly interpolated. Range [0, 1].
double lattice(int x, int y) {
  return random_unit(random_key(7, static_cast<std::uint32_t>(x)), static_cast<std::uint32_t>(y));
}

double noise(double x, double y) {
  const double fx = std::floor(x), fy = std::floor(y);
  const int ix = static_cast<int>(fx), iy = static_cast<int>(fy);
  const auto smooth = [](double f) { return f * f * (3 - 2 * f); };
  const double u = smooth(x - fx), v = smooth(y - fy);
  return (1 - v) * ((1 - u) * lattice(ix, iy) + u * lattice(ix + 1, iy)) +
         v * ((1 - u) * lattice(ix, iy + 1) + u * lattice(ix + 1, iy + 1));
}

double fraction(double x) { return x - std::floor(x); }

// Lane dashes 1.5 m long every 3 m at y = +-1.75, a stop line, grass beyond |y| = 4.5.
Vector3d ground_colour(const Vector3d& p) {
  const double grain = 0.75 + 0.3 * noise(3 * p.x(), 3 * p.y()) + 0.2 * noise(9 * p.x(), 9 * p.y());
  if (std::abs(p.y()) > 4.5)
    return Vector3d(0.10, 0.22, 0.06) * grain * (0.7 + 0.6 * noise(0.7 * p.x(), 0.7 * p.y()));
  if (std::abs(p.y()) > 4.2) return Vector3d(0.45, 0.44, 0.42) * grain;
  const bool dash = std::abs(std::abs(p.y()) - 1.75) < 0.08 && fraction(p.x() / 3.0) < 0.5;
  const bool stop_line = p.x() > 14.0 && p.x() < 14.4 && std::abs(p.y()) < 1.67;
  if (dash || stop_line) return Vector3d(0.75, 0.74, 0.70) * (0.9 + 0.1 * grain);
  return Vector3d(0.13, 0.13, 0.14) * grain;
}

// u runs along the wall, v up it; metres.
Vector3d wall_colour(const Hit& hit, double u, double v) {
  switch (hit.texture) {
    case Texture::kBrick: {
      const double row = std::floor(v / 0.3),
                   shifted = u / 0.6 + 0.5 * std::fmod(std::abs(row), 2.0);
      const bool mortar = fraction(v / 0.3) < 0.12 || fraction(shifted) < 0.06;
      const double tint =
          0.8 + 0.4 * lattice(static_cast<int>(std::floor(shifted)), static_cast<int>(row));
      return mortar ? hit.second_colour : Vector3d(hit.colour * tint);
    }
    case Texture::kFacade: {
      const double a = fraction(u / 2.0), b = fraction((v - 0.6) / 2.2);
      const bool window = v > 0.6 && a > 0.25 && a < 0.75 && b > 0.15 && b < 0.75;
      const bool frame = v > 0.6 && a > 0.21 && a < 0.79 && b > 0.11 && b < 0.79;
      if (window) {
        const bool bar = std::abs(a - 0.5) < 0.015 || std::abs(b - 0.5) < 0.015;
        return bar ? Vector3d(0.6, 0.6, 0.6) : Vector3d(hit.second_colour * (0.6 + 0.8 * b));
      }
      return frame ? Vector3d(0.65, 0.64, 0.6)
                   : Vector3d(hit.colour * (0.85 + 0.2 * noise(2 * u, 2 * v)));
    }
    case Texture::kChecker:
      return (static_cast<int>(std::floor(u / 0.25)) + static_cast<int>(std::floor(v / 0.25))) % 2
                 ? hit.colour
                 : hit.second_colour;
    case Texture::kStripes: return fraction((u + v) / 0.5) < 0.5 ? hit.colour : hit.second_colour;
    default: return hit.colour * (0.9 + 0.2 * noise(4 * u, 4 * v));
  }
}

Vector3d albedo(const Hit& hit, const Vector3d& point, bool is_ground, bool is_sphere) {
  if (is_ground) return ground_colour(point);
  if (is_sphere) {
    // Eight stripes of longitude, cut by a belt at the equator.
    const double longitude = std::atan2(hit.local.y(), hit.local.x()) / (2 * M_PI);
    const bool belt = std::abs(hit.local.z()) < 0.12;
    return belt                            ? Vector3d(0.8, 0.8, 0.8)
           : fraction(8 * longitude) < 0.5 ? hit.colour
                                           : hit.second_colour;
  }
  if (std::abs(hit.normal.z()) > 0.5) return wall_colour(hit, point.x(), point.y());
  return std::abs(hit.normal.x()) > 0.5 ? wall_colour(hit, point.y(), point.z())
                                        : wall_colour(hit, point.x(), point.z());
}

void hit_box(const Box& box, const Vector3d& origin, const Vector3d& direction, Hit* best) {
  double enter = -std::numeric_limits<double>::infinity(),
         leave = std::numeric_limits<double>::infinity();
  int axis = 0;
  for (int d = 0; d < 3; ++d) {
    if (direction[d] == 0) {
      if (origin[d] < box.low[d] || origin[d] > box.high[d]) return;
      continue;
    }
    double a = (box.low[d] - origin[d]) / direction[d],
           b = (box.high[d] - origin[d]) / direction[d];
    if (a > b) std::swap(a, b);
    if (a > enter) enter = a, axis = d;
    leave = std::min(leave, b);
  }
  if (enter > leave || enter <= kRayStart || enter >= best->t) return;
  Vector3d normal = Vector3d::Zero();
  normal[axis] = direction[axis] > 0 ? -1 : 1;
  *best = {enter, normal, box.texture, box.colour, box.second_colour, Vector3d::Zero()};
}

bool hit_sphere(const Sphere& sphere, const Vector3d& origin, const Vector3d& direction,
                Hit* best) {
  const Vector3d to_center = sphere.center - origin;
  const double along = to_center.dot(direction);
  const double discriminant =
      along * along - to_center.squaredNorm() + sphere.radius * sphere.radius;
  if (discriminant < 0) return false;
  const double t = along - std::sqrt(discriminant);
  if (t <= kRayStart || t >= best->t) return false;
  const Vector3d local = (origin + t * direction - sphere.center) / sphere.radius;
  *best = {t, local, sphere.texture, sphere.colour, sphere.second_colour, local};
  return true;
}

struct Closest {
  Hit hit;
  bool ground = false, sphere = false;
};

Closest closest(const Courtyard& scene, const Vector3d& origin, const Vector3d& direction) {
  Closest found;
  if (direction.z() < 0 && -origin.z() / direction.z() > kRayStart) {
    found.hit.t = -origin.z() / direction.z();
    found.ground = true;
  }
  const double ground_t = found.hit.t;
  for (const Box& box : scene.boxes) hit_box(box, origin, direction, &found.hit);
  for (const Sphere& sphere : scene.spheres)
    if (hit_sphere(sphere, origin, direction, &found.hit)) found.sphere = true;
  found.ground = found.ground && found.hit.t == ground_t;
  // A box in front of a sphere hit earlier cannot happen: boxes are tested first.
  return found;
}

Vector3d sky(const Vector3d& direction, const Vector3d& to_sun) {
  const double height = std::clamp(direction.z(), 0.0, 1.0);
  const Vector3d horizon(0.62, 0.70, 0.80), zenith(0.14, 0.32, 0.66);
  const double glow = std::pow(std::max(0.0, direction.dot(to_sun)), 24.0);
  return horizon + (zenith - horizon) * std::sqrt(height) + Vector3d(0.5, 0.42, 0.25) * glow;
}

// IEC 61966-2-1, linear -> sRGB.
double encode(double linear) {
  linear = std::clamp(linear, 0.0, 1.0);
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

}  // namespace

Courtyard make_courtyard(unsigned seed) {
  Courtyard scene;
  scene.to_sun = Vector3d(-0.35, 0.55, 0.76).normalized();
  const std::uint64_t key = random_key(seed, kStreamTest);
  std::uint64_t drawn = 0;
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * random_unit(key, drawn++);
  };
  const Vector3d brick(0.42, 0.17, 0.11), mortar(0.5, 0.48, 0.44), plaster(0.62, 0.52, 0.36),
      glass(0.09, 0.14, 0.2);
  const Vector3d stone(0.5, 0.5, 0.48), dark_stone(0.3, 0.31, 0.33), blue_plaster(0.3, 0.42, 0.52);
  // The court's walls: facade left and ahead, bricks right and behind.
  scene.boxes.push_back({{-14, 8.0, 0}, {30, 9.5, 7.4}, Texture::kFacade, plaster, glass});
  scene.boxes.push_back({{-14, -8.5, 0}, {30, -7.0, 3.4}, Texture::kBrick, brick, mortar});
  scene.boxes.push_back({{24, -7.0, 0}, {25.5, 8.0, 5.2}, Texture::kFacade, blue_plaster, glass});
  scene.boxes.push_back({{-14, -7.0, 0}, {-12.5, 8.0, 2.6}, Texture::kBrick, stone, dark_stone});
  // A portal over the road, lamp posts along it.
  scene.boxes.push_back(
      {{17.0, 3.6, 0}, {17.6, 4.2, 4.2}, Texture::kStripes, {0.7, 0.08, 0.06}, {0.75, 0.75, 0.72}});
  scene.boxes.push_back({{17.0, -4.2, 0},
                         {17.6, -3.6, 4.2},
                         Texture::kStripes,
                         {0.7, 0.08, 0.06},
                         {0.75, 0.75, 0.72}});
  scene.boxes.push_back({{17.0, -3.6, 3.5},
                         {17.6, 3.6, 4.2},
                         Texture::kChecker,
                         {0.72, 0.6, 0.08},
                         {0.08, 0.08, 0.08}});
  for (const double x : {-6.0, 1.0, 8.0, 15.0})
    scene.boxes.push_back(
        {{x, 5.2, 0}, {x + 0.14, 5.34, 4.6}, Texture::kMetal, dark_stone, dark_stone});
  // Crates and balls on both sides.
  const Vector3d palette[] = {{0.62, 0.12, 0.08},
                              {0.08, 0.3, 0.55},
                              {0.68, 0.52, 0.06},
                              {0.1, 0.42, 0.2},
                              {0.55, 0.3, 0.1}};
  for (int i = 0; i < 10; ++i) {
    const double x = -9 + 2.9 * i + uniform(-0.5, 0.5), side = i % 2 ? 1 : -1;
    const double y = side * uniform(4.9, 6.2), size = uniform(0.7, 1.5), height = uniform(0.6, 1.7);
    scene.boxes.push_back({{x - size / 2, y - size / 2, 0},
                           {x + size / 2, y + size / 2, height},
                           i % 3 ? Texture::kChecker : Texture::kStripes,
                           palette[i % 5],
                           Vector3d(0.66, 0.64, 0.58)});
  }
  for (int i = 0; i < 9; ++i) {
    const double x = -8 + 3.1 * i + uniform(-0.6, 0.6), side = i % 2 ? -1 : 1,
                 radius = uniform(0.35, 0.8);
    scene.spheres.push_back({{x, side * uniform(3.0, 4.2), radius},
                             radius,
                             Texture::kStripes,
                             palette[(i + 2) % 5],
                             Vector3d(0.7, 0.68, 0.62)});
  }
  return scene;
}

RayColour trace(const Courtyard& scene, const Eigen::Vector3d& origin,
                const Eigen::Vector3d& direction) {
  const Closest found = closest(scene, origin, direction);
  Vector3d linear;
  double distance = 0;
  if (std::isinf(found.hit.t)) {
    linear = sky(direction, scene.to_sun);
  } else {
    distance = found.hit.t;
    const Vector3d point = origin + distance * direction;
    const double facing = std::max(0.0, found.hit.normal.dot(scene.to_sun));
    const bool lit =
        facing > 0 &&
        std::isinf(closest(scene, point + 1e-4 * found.hit.normal, scene.to_sun).hit.t);
    const double ambient = 0.38 + 0.14 * found.hit.normal.z();
    linear = albedo(found.hit, point, found.ground, found.sphere) *
             (ambient + (lit ? 1.15 * facing : 0.0));
  }
  return {linear.unaryExpr([](double v) { return encode(v); }), distance};
}

}  // namespace redrive::analytic
