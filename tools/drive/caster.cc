// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/caster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <Eigen/Geometry>

namespace redrive::drive {
namespace {

using Eigen::Vector3d;

constexpr double kRayStart_m = 1e-6;
constexpr int kLeafSize = 3;

Vector3d into_own_axes(const Primitive& p, const Vector3d& v) {
  return {p.cos_yaw * v.x() + p.sin_yaw * v.y(), p.cos_yaw * v.y() - p.sin_yaw * v.x(), v.z()};
}
Vector3d into_world_axes(const Primitive& p, const Vector3d& v) {
  return {p.cos_yaw * v.x() - p.sin_yaw * v.y(), p.cos_yaw * v.y() + p.sin_yaw * v.x(), v.z()};
}

bool is_nearer(double distance_m, const Hit& nearest) {
  return distance_m > kRayStart_m && distance_m < nearest.distance_m;
}

/// Moeller, Trumbore, "Fast, minimum storage ray-triangle intersection", 1997; both sides.
void intersect_triangle(const Primitive& p, int index, const Vector3d& origin,
                        const Vector3d& direction, Hit* nearest) {
  const Vector3d along = p.b - p.a, across = p.c - p.a, h = direction.cross(across);
  const double determinant = along.dot(h);
  if (std::abs(determinant) < 1e-12) return;
  const Vector3d from = origin - p.a;
  const double u = from.dot(h) / determinant;
  if (u < 0 || u > 1) return;
  const Vector3d q = from.cross(along);
  const double v = direction.dot(q) / determinant;
  if (v < 0 || u + v > 1) return;
  const double distance_m = across.dot(q) / determinant;
  if (!is_nearer(distance_m, *nearest)) return;
  const Vector3d normal = along.cross(across).normalized();
  *nearest = {distance_m, index, normal.dot(direction) > 0 ? Vector3d(-normal) : normal,
              origin + distance_m * direction - p.a};
}

void intersect_box(const Primitive& p, int index, const Vector3d& o, const Vector3d& d,
                   Hit* nearest) {
  double enter = -std::numeric_limits<double>::infinity(),
         leave = std::numeric_limits<double>::infinity();
  int axis = 0;
  for (int k = 0; k < 3; ++k) {
    if (d[k] == 0) {
      if (std::abs(o[k]) > p.b[k]) return;
      continue;
    }
    const double side = std::copysign(p.b[k], d[k]), near = (-side - o[k]) / d[k];
    if (near > enter) enter = near, axis = k;
    leave = std::min(leave, (side - o[k]) / d[k]);
  }
  if (enter > leave || !is_nearer(enter, *nearest)) return;
  Vector3d normal = Vector3d::Zero();
  normal[axis] = d[axis] > 0 ? -1 : 1;
  *nearest = {enter, index, into_world_axes(p, normal), o + enter * d};
}

void intersect_cylinder(const Primitive& p, int index, const Vector3d& o, const Vector3d& d,
                        Hit* nearest) {
  const double radius = p.b.x(), half_height = p.b.z();
  if (d.z() < 0 && o.z() > half_height) {  // the upper end
    const double distance_m = (half_height - o.z()) / d.z();
    const Vector3d at = o + distance_m * d;
    if (at.head<2>().squaredNorm() <= radius * radius && is_nearer(distance_m, *nearest)) {
      *nearest = {distance_m, index, Vector3d::UnitZ(), at};
      return;
    }
  }
  const double a = d.head<2>().squaredNorm(), b = o.head<2>().dot(d.head<2>()),
               c = o.head<2>().squaredNorm() - radius * radius, discriminant = b * b - a * c;
  if (a == 0 || discriminant < 0) return;
  const double distance_m = (-b - std::sqrt(discriminant)) / a;
  const Vector3d at = o + distance_m * d;
  if (std::abs(at.z()) > half_height || !is_nearer(distance_m, *nearest)) return;
  *nearest = {distance_m, index, into_world_axes(p, Vector3d(at.x() / radius, at.y() / radius, 0)),
              at};
}

void intersect_ellipsoid(const Primitive& p, int index, const Vector3d& o, const Vector3d& d,
                         Hit* nearest) {
  const Vector3d origin = o.cwiseQuotient(p.b), direction = d.cwiseQuotient(p.b);
  const double a = direction.squaredNorm(), b = origin.dot(direction),
               discriminant = b * b - a * (origin.squaredNorm() - 1);
  if (discriminant < 0) return;
  const double distance_m = (-b - std::sqrt(discriminant)) / a;
  if (!is_nearer(distance_m, *nearest)) return;
  const Vector3d at = o + distance_m * d;
  const Vector3d normal = at.cwiseQuotient(p.b.cwiseProduct(p.b)).normalized();
  *nearest = {distance_m, index, into_world_axes(p, normal), at};
}

std::array<Vector3d, 2> bounds_of(const Primitive& p) {
  if (p.shape == Shape::kTriangle)
    return {p.a.cwiseMin(p.b).cwiseMin(p.c), p.a.cwiseMax(p.b).cwiseMax(p.c)};
  const double c = std::abs(p.cos_yaw), s = std::abs(p.sin_yaw);
  const Vector3d half(c * p.b.x() + s * p.b.y(), s * p.b.x() + c * p.b.y(), p.b.z());
  return {p.a - half, p.a + half};
}

/// Bounds are floats: 0.6 mm at 10 km, and as much in the ray's origin.
float outwards(double bound, double sign) {
  return static_cast<float>(bound + sign * (1e-3 + 1e-6 * std::abs(bound)));
}

}  // namespace

void intersect(const Primitive& primitive, int index, const Vector3d& origin,
               const Vector3d& direction, Hit* nearest) {
  if (primitive.shape == Shape::kTriangle)
    return intersect_triangle(primitive, index, origin, direction, nearest);
  const Vector3d o = into_own_axes(primitive, origin - primitive.a),
                 d = into_own_axes(primitive, direction);
  switch (primitive.shape) {
    case Shape::kBox: return intersect_box(primitive, index, o, d, nearest);
    case Shape::kCylinder: return intersect_cylinder(primitive, index, o, d, nearest);
    default: return intersect_ellipsoid(primitive, index, o, d, nearest);
  }
}

Caster::Caster(std::vector<Primitive> primitives) {
  std::vector<Node> bounds;
  for (const Primitive& primitive : primitives) {
    const auto [low, high] = bounds_of(primitive);
    Node box;
    for (int k = 0; k < 3; ++k)
      box.low[k] = outwards(low[k], -1), box.high[k] = outwards(high[k], 1);
    box.first = static_cast<int>(bounds.size());
    bounds.push_back(box);
  }
  if (primitives.empty()) return;
  nodes_.reserve(2 * primitives.size());
  nodes_.emplace_back();
  build(0, 0, static_cast<int>(bounds.size()), &bounds);
  primitives_.reserve(primitives.size());  // in the order of the leaves
  for (const Node& box : bounds) primitives_.push_back(primitives[box.first]);
}

int Caster::split(int begin, int end, std::vector<Node>* bounds) {
  constexpr int kBins = 16;
  struct Bin {
    float low[3], high[3];
    int count = 0;
    void add(const float* other_low, const float* other_high, int n) {
      for (int k = 0; k < 3 && n > 0; ++k) {
        low[k] = count > 0 ? std::min(low[k], other_low[k]) : other_low[k];
        high[k] = count > 0 ? std::max(high[k], other_high[k]) : other_high[k];
      }
      count += n;
    }
    float cost() const {  // half of the surface, times what is inside
      const float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
      return count > 0 ? (x * y + y * z + z * x) * static_cast<float>(count) : 0;
    }
  };
  const auto middle_of = [](const Node& box, int k) { return box.low[k] + box.high[k]; };
  float least_cost = std::numeric_limits<float>::infinity(), best_edge = 0;
  int best_axis = 0;
  for (int k = 0; k < 3; ++k) {
    const auto [first, last] = std::minmax_element(
        bounds->begin() + begin, bounds->begin() + end,
        [&](const Node& a, const Node& b) { return middle_of(a, k) < middle_of(b, k); });
    const float low = middle_of(*first, k), width = (middle_of(*last, k) - low) / kBins;
    if (!(width > 0)) continue;
    std::array<Bin, kBins> bins, after;  // after: this bin and all behind it
    for (int i = begin; i < end; ++i) {
      const Node& box = (*bounds)[i];
      const int bin = std::min(kBins - 1, static_cast<int>((middle_of(box, k) - low) / width));
      bins[bin].add(box.low, box.high, 1);
    }
    after = bins;
    for (int i = kBins - 2; i >= 0; --i)
      after[i].add(after[i + 1].low, after[i + 1].high, after[i + 1].count);
    Bin before;
    for (int i = 0; i + 1 < kBins; ++i) {
      before.add(bins[i].low, bins[i].high, bins[i].count);
      const float cost = before.cost() + after[i + 1].cost();
      if (before.count == 0 || after[i + 1].count == 0 || cost >= least_cost) continue;
      least_cost = cost;
      best_axis = k;
      best_edge = low + width * static_cast<float>(i + 1);
    }
  }
  const auto middle =
      std::stable_partition(bounds->begin() + begin, bounds->begin() + end,
                            [&](const Node& box) { return middle_of(box, best_axis) < best_edge; });
  const int at = static_cast<int>(middle - bounds->begin());
  return at == begin || at == end ? begin + (end - begin) / 2 : at;
}

void Caster::build(int node, int begin, int end, std::vector<Node>* bounds) {
  Node whole = (*bounds)[begin];
  for (int i = begin; i < end; ++i)
    for (int k = 0; k < 3; ++k) {
      whole.low[k] = std::min(whole.low[k], (*bounds)[i].low[k]);
      whole.high[k] = std::max(whole.high[k], (*bounds)[i].high[k]);
    }
  whole.first = begin;
  whole.count = end - begin;
  if (whole.count > kLeafSize) {
    const int middle = split(begin, end, bounds);
    whole.count = 0;
    whole.first = static_cast<int>(nodes_.size());
    nodes_.resize(nodes_.size() + 2);
    build(whole.first, begin, middle, bounds);
    build(whole.first + 1, middle, end, bounds);
  }
  nodes_[node] = whole;
}

template <bool any>
Hit Caster::traverse(const Vector3d& origin, const Vector3d& direction) const {
  Hit nearest;
  if (nodes_.empty()) return nearest;
  const float o[3] = {float(origin.x()), float(origin.y()), float(origin.z())};
  float inverse[3];
  for (int k = 0; k < 3; ++k)
    inverse[k] =
        1 / static_cast<float>(std::abs(direction[k]) > 1e-12 ? direction[k]
                                                              : std::copysign(1e-12, direction[k]));
  constexpr float kMissed = std::numeric_limits<float>::infinity();
  const auto enters = [&](const Node& node) {
    float enter = 0, leave = static_cast<float>(nearest.distance_m);
    for (int k = 0; k < 3; ++k) {
      const float a = (node.low[k] - o[k]) * inverse[k], b = (node.high[k] - o[k]) * inverse[k];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    return enter <= leave ? enter : kMissed;
  };
  std::array<std::pair<float, int>, 64> stack;  // depth: log2 of the number of primitives
  int size = 0;
  stack[size++] = {enters(nodes_[0]), 0};
  while (size > 0) {
    const auto [at, index] = stack[--size];
    if (at >= static_cast<float>(nearest.distance_m)) continue;
    const Node& node = nodes_[index];
    if (node.count > 0) {
      for (int i = node.first; i < node.first + node.count; ++i)
        intersect(primitives_[i], i, origin, direction, &nearest);
      if (any && nearest.found()) return nearest;
      continue;
    }
    std::pair<float, int> near{enters(nodes_[node.first]), node.first},
        far{enters(nodes_[node.first + 1]), node.first + 1};
    if (far.first < near.first) std::swap(near, far);
    if (far.first != kMissed) stack[size++] = far;
    if (near.first != kMissed) stack[size++] = near;
  }
  return nearest;
}

Hit Caster::cast(const Vector3d& origin, const Vector3d& direction) const {
  return traverse<false>(origin, direction);
}

bool Caster::is_occluded(const Vector3d& origin, const Vector3d& direction) const {
  return traverse<true>(origin, direction).found();
}

}  // namespace redrive::drive
