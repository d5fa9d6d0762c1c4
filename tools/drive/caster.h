// SPDX-License-Identifier: Apache-2.0
// Casts rays against triangles, boxes, cylinders and ellipsoids.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Core>

namespace redrive::drive {

/// How a surface is coloured (textures.h).
enum class Material : std::uint8_t {
  kGround,
  kHouse,
  kRoof,
  kCarBody,
  kCarCabin,
  kTyre,
  kBark,
  kLeaves,
  kMetal,
  kSign,
  kPoster,
  kWood
};

enum class Shape : std::uint8_t { kTriangle, kBox, kCylinder, kEllipsoid };

struct Primitive {
  Shape shape = Shape::kBox;
  Material material = Material::kMetal;
  std::uint32_t seed = 0;  ///< seed of its texture
  Eigen::Vector3f colour{0.3f, 0.3f, 0.3f}, second_colour{0.3f, 0.3f, 0.3f};  ///< linear RGB
  /// Corners of a triangle. Else a: the centre; b: half the size along the own axes, which are the
  /// world's turned by the yaw about z. A cylinder is upright with radius b.x().
  Eigen::Vector3d a = Eigen::Vector3d::Zero(), b = a, c = a;
  double cos_yaw = 1, sin_yaw = 0;
  /// on the ground: the part of the road that it belongs to
  double road_s_m = 0, road_length_m = 0;
};

struct Hit {
  double distance_m = std::numeric_limits<double>::infinity();  ///< infinity: nothing was hit
  int primitive = -1;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, against the ray
  Eigen::Vector3d local = Eigen::Vector3d::Zero();    ///< from the centre, in the primitive's axes

  bool found() const { return primitive >= 0; }
};

/// A ray begins outside of boxes and ellipsoids: surfaces are hit where it enters them.
void intersect(const Primitive& primitive, int index, const Eigen::Vector3d& origin,
               const Eigen::Vector3d& direction, Hit* nearest);

/// A bounding volume hierarchy, split by the surface area heuristic (MacDonald, Booth, "Heuristics
/// for ray tracing using space subdivision", 1990) over bins.
class Caster {
 public:
  Caster() = default;
  explicit Caster(std::vector<Primitive> primitives);

  const std::vector<Primitive>& primitives() const { return primitives_; }
  /// The nearest hit along a unit direction.
  Hit cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;
  /// Whether anything lies in the direction.
  bool is_occluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;

 private:
  struct Node {
    float low[3], high[3];
    int first = 0, count = 0;  ///< count > 0: primitives; else the nodes first and first + 1
  };
  template <bool any>
  Hit traverse(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;
  /// Orders bounds `begin` to `end` - 1 and returns the first one of the second part.
  int split(int begin, int end, std::vector<Node>* bounds);
  void build(int node, int begin, int end, std::vector<Node>* bounds);

  std::vector<Primitive> primitives_;
  std::vector<Node> nodes_;
};

}  // namespace redrive::drive
