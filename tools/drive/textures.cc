// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/textures.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tools/drive/noise.h"

namespace redrive::drive {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

Vector3f mix(const Vector3f& a, const Vector3f& b, float of_b) { return a + of_b * (b - a); }

/// Position along the road and to the left of its centre line: between the normals at both ends of
/// the piece of ground, continuous from piece to piece.
Eigen::Vector2d on_road(const Road& road, const Primitive& piece, const Vector3d& point) {
  const long begin = std::lround(piece.road_s_m), end = begin + std::lround(piece.road_length_m);
  const Road::Knot &from = road.knot(begin), &to = road.knot(end);
  const Eigen::Vector2d from_m = point.head<2>() - from.centre, to_m = point.head<2>() - to.centre;
  const auto left_of = [](const Road::Knot& knot, const Eigen::Vector2d& v) {
    return knot.ahead.x() * v.y() - knot.ahead.y() * v.x();
  };
  const double after = from.ahead.dot(from_m), before = -to.ahead.dot(to_m);
  const double u = after / std::max(after + before, 1e-9);
  return {piece.road_s_m + u * piece.road_length_m,
          (1 - u) * left_of(from, from_m) + u * left_of(to, to_m)};
}

/// Paint of lanes, parking bays and crossings, 0..1.
float paint_on_road(double s, double t, double f) {
  float paint = lines(s - 1.5, 9, 3, f) * inside(t, -0.06, 0.06, f);  // the centre line
  const double side = std::abs(t);
  paint = std::max(paint, inside(side, kLaneEdge_m - 0.05, kLaneEdge_m + 0.05, f));
  paint = std::max(paint, lines(s + 3, 6, 0.1, f) * inside(side, kLaneEdge_m, 5.2, f));
  const std::int64_t lot = cell_of(s / 60);
  const double crossing = 60 * (static_cast<double>(lot) + 0.2 + 0.6 * cell_value(lot, 0, 71));
  if (cell_value(lot, 1, 71) < 0.6f) {
    paint *= 1 - inside(s, crossing - 2.2, crossing + 2.2, f);
    paint = std::max(paint, lines(t, 1, 0.5, f) * inside(s, crossing - 1.6, crossing + 1.6, f) *
                                inside(side, -1, 5, f));
  }
  return paint;
}

Vector3f asphalt(double s, double t, double f) {
  float grain =
      1 + 0.16f * octaves(s, t, 4.1, 4, 0.7f, f, 11) + 0.30f * octaves(s, t, 0.31, 5, 0.8f, f, 17);
  grain *= 1 + 0.08f *
                   static_cast<float>(std::cos(2 * std::numbers::pi * (std::abs(t) - 1.6) / 1.7)) *
                   (std::abs(t) < kLaneEdge_m ? 1.0f : 0.0f);
  Vector3f colour = Vector3f(0.135f, 0.135f, 0.145f) * grain;
  // Patches of a repair, one in each lot of 7 m and lane.
  const std::int64_t lot = cell_of(s / 7), lane = cell_of(t / 2.7);
  const double along = 7 * part_of_cell(s / 7), across = 2.7 * part_of_cell(t / 2.7);
  if (cell_value(lot, lane, 23) < 0.4f) {
    const double width = 0.5 + 2 * cell_value(lot, lane, 24),
                 length = 0.8 + 4 * cell_value(lot, lane, 25),
                 at_s = 0.2 + cell_value(lot, lane, 26), at_t = 0.1;
    const float patch =
                    inside(along, at_s, at_s + length, f) * inside(across, at_t, at_t + width, f),
                seam = patch - inside(along, at_s + 0.05, at_s + length - 0.05, f) *
                                   inside(across, at_t + 0.05, at_t + width - 0.05, f);
    colour *= 1 + patch * (cell_value(lot, lane, 27) < 0.5f ? -0.35f : 0.3f);
    colour *= 1 - 0.6f * std::max(0.0f, seam);
  }
  // Cracks along the zero crossings of noise.
  const float ridge = std::abs(value_noise(s / 1.7, t / 0.9, 31) +
                               0.5f * value_noise(s / 0.4, t / 0.4, 32)),
              width = std::max(0.025f, static_cast<float>(f) / 0.9f);
  if (value_noise(s / 9, t / 5, 33) > 0.1f)
    colour *= 1 - 0.55f * std::clamp(1 - ridge / width, 0.0f, 1.0f) * 0.025f / width;
  // Manholes.
  const std::int64_t hole = cell_of(s / 19);
  const double from_s = s - 19 * (static_cast<double>(hole) + 0.1 + 0.8 * cell_value(hole, 0, 41)),
               from_t = t - (cell_value(hole, 1, 41) < 0.5f ? -0.4 : 1.9),
               radius = std::hypot(from_s, from_t);
  if (radius < 0.45) {
    const float lid = inside(radius, -1, 0.36, f),
                pattern = lines(from_s, 0.09, 0.04, f) + lines(from_t, 0.09, 0.04, f);
    colour = mix(colour, Vector3f(0.2f, 0.19f, 0.17f) * (0.6f + 0.5f * pattern), lid);
    colour *= 1 - 0.7f * inside(radius, 0.34, 0.39, f);
  }
  return colour;
}

Vector3f pavement(double s, double t, double f) {
  const double side = std::abs(t);
  const std::int64_t stone = cell_of(s / 0.5), row = cell_of(side / 0.5) + (t > 0 ? 500 : 0);
  const float known = std::clamp(static_cast<float>(0.5 / f) - 1, 0.0f, 1.0f);
  float grain = 1 + known * 0.34f * (cell_value(stone, row, 51) - 0.5f) +
                0.12f * octaves(s, t, 2.3, 3, 0.8f, f, 52) +
                0.2f * octaves(s, t, 0.17, 4, 0.8f, f, 57);
  grain *= 1 - 0.45f * std::max(lines(s, 0.5, 0.016, f), lines(side, 0.5, 0.016, f));
  const float gum = value_noise(s / 0.11, t / 0.11, 61);
  if (gum > 0.86f && f < 0.1) grain *= 0.6f;
  return Vector3f(0.33f, 0.32f, 0.30f) * grain;
}

Vector3f grass(double x, double y, double f) {
  const float grain = 1 + 0.35f * octaves(x, y, 7, 5, 0.75f, f, 81) +
                      0.35f * octaves(x, y, 0.2, 4, 0.8f, f, 87),
              dry = 0.5f + 0.5f * octaves(x, y, 11, 2, 0.5f, f, 93);
  return mix(Vector3f(0.09f, 0.17f, 0.05f), Vector3f(0.22f, 0.19f, 0.10f),
             std::clamp(dry, 0.0f, 1.0f)) *
         std::max(0.2f, grain);
}

Vector3f ground(const Road& road, const Primitive& p, const Hit& hit, const Vector3d& point,
                double f) {
  const Eigen::Vector2d at = on_road(road, p, point);
  const double s = at.x(), t = at.y(), side = std::abs(t);
  if (side > kPavementEdge_m + 0.01) return grass(s, t, f);
  const bool is_face = hit.normal.z() < 0.5;
  if (is_face || (side > kKerb_m - 1e-3 && side < kKerb_m + 0.16)) {
    const std::int64_t stone = cell_of(s);
    const float tint = 0.85f + 0.3f * cell_value(stone, t > 0, 101) +
                       0.2f * octaves(s, point.z() + t, 0.13, 3, 0.8f, f, 103);
    return Vector3f(0.42f, 0.41f, 0.39f) * tint * (1 - 0.6f * lines(s, 1, 0.02, f));
  }
  if (side > kKerb_m) return pavement(s, t, f);
  Vector3f colour = asphalt(s, t, f);
  const float worn = 0.85f + 0.35f * octaves(s, t, 0.4, 4, 0.8f, f, 111);
  colour = mix(colour, Vector3f(0.66f, 0.65f, 0.62f),
               std::clamp(worn, 0.0f, 1.0f) * paint_on_road(s, t, f));
  const float gutter = inside(side, kKerb_m - 0.35, kKerb_m, f);
  return colour * (1 - 0.25f * gutter);
}

Vector3f wall_of_house(const Primitive& p, double u, double v, double f, std::uint32_t style) {
  const auto drawn = [&](int k) { return cell_value(k, 7, p.seed); };
  Vector3f colour = p.colour;
  if (drawn(0) < 0.45f) {  // bricks
    const double row_m = 0.085, length_m = 0.26;
    const std::int64_t row = cell_of(v / row_m);
    const double shifted = u + (row % 2 ? 0.5 * length_m : 0);
    const float mortar = std::max(lines(v, row_m, 0.012, f), lines(shifted, length_m, 0.012, f)),
                known = std::clamp(static_cast<float>(row_m / f) - 1, 0.0f, 1.0f);
    colour *= 1 + known * 0.5f * (cell_value(cell_of(shifted / length_m), row, style) - 0.5f);
    colour = mix(colour, Vector3f(0.45f, 0.43f, 0.40f), 0.7f * mortar);
  } else {
    colour *= 1 + 0.14f * octaves(u, v, 0.08, 3, 0.7f, f, style + 1);
    if (drawn(0) > 0.75f) colour *= 1 - 0.3f * lines(v, 0.6, 0.025, f);
  }
  // Dirt: large stains, and streaks below sills.
  colour *= 1 + 0.16f * octaves(u, v, 2.7, 3, 0.7f, f, style + 11) +
            0.1f * octaves(u, 0.15 * v, 0.33, 3, 0.7f, f, style + 21);
  return colour * std::clamp(0.65f + static_cast<float>(v) * 0.35f, 0.65f, 1.0f);
}

Vector3f house(const Primitive& p, const Hit& hit, double f) {
  if (hit.normal.z() > 0.5) return Vector3f(0.2f, 0.19f, 0.18f);
  const bool along_x = std::abs(hit.local.y()) / p.b.y() > std::abs(hit.local.x()) / p.b.x();
  const int face = along_x ? (hit.local.y() > 0) : 2 + (hit.local.x() > 0);
  const double width = 2 * (along_x ? p.b.x() : p.b.y()),
               u = (along_x ? hit.local.x() : hit.local.y()) + width / 2,
               v = hit.local.z() + p.b.z() - 1.5 - kKerbHeight_m, height = 2 * p.b.z() - 1.5;
  const auto drawn = [&](int k) { return static_cast<double>(cell_value(k, 3, p.seed)); };
  const std::uint32_t style = p.seed + static_cast<std::uint32_t>(face) * 977u;
  Vector3f colour = wall_of_house(p, u, v, f, style);
  const double floor_m = 2.7 + drawn(0), pitch_m = 1.9 + 1.6 * drawn(1),
               shop_m = drawn(2) < 0.4 ? 3.4 : 0, base_m = shop_m > 0 ? shop_m : 0.6;
  const Vector3f trim =
      drawn(3) < 0.7 ? Vector3f(0.62f, 0.61f, 0.58f) : Vector3f(0.2f, 0.13f, 0.08f);
  if (v > base_m && v < height - 0.4) {
    const double from_m = std::max(0.0, (width - pitch_m * std::floor(width / pitch_m)) / 2);
    const std::int64_t column = cell_of((u - from_m) / pitch_m),
                       row = cell_of((v - base_m) / floor_m);
    const bool whole = (static_cast<double>(row) + 0.85) * floor_m + base_m < height &&
                       u > from_m && u < width - from_m;
    const double x = u - from_m - pitch_m * static_cast<double>(column),
                 y = v - base_m - floor_m * static_cast<double>(row);
    const double half = 0.5 * pitch_m * (0.42 + 0.2 * drawn(4)), low = 0.85, high = 0.8 * floor_m;
    if (whole) {
      const double from_middle = std::abs(x - pitch_m / 2);
      const float frame = inside(from_middle, -9, half + 0.09, f) *
                          inside(y, low - 0.1, high + 0.09, f),
                  glass = inside(from_middle, -9, half, f) * inside(y, low, high, f),
                  sill =
                      inside(from_middle, -9, half + 0.14, f) * inside(y, low - 0.2, low - 0.1, f);
      colour = mix(colour, trim, frame);
      colour *= 1 - 0.5f * sill;
      const float kind = cell_value(column, row, style + 31);
      Vector3f pane = Vector3f(0.05f, 0.07f, 0.09f) *
                      (0.7f + 1.2f * static_cast<float>((y - low) / (high - low)) * kind);
      if (kind > 0.55f) {  // curtains to both sides
        const double open = 0.15 + 0.6 * cell_value(column, row, style + 32);
        const float curtain = 1 - inside(from_middle, -9, open * half, f);
        pane = mix(pane,
                   Vector3f(0.45f, 0.42f, 0.36f) *
                       (0.8f + 0.2f * octaves(x, 0.1 * y, 0.12, 2, 0.8f, f, style + 33)),
                   curtain);
      } else if (kind < 0.2f) {  // a blind
        const double down = high - (high - low) * (0.3 + 3 * kind);
        pane = mix(pane, Vector3f(0.5f, 0.49f, 0.45f) * (1 - 0.3f * lines(y, 0.07, 0.02, f)),
                   inside(y, down, high, f));
      }
      const float bars =
          std::max(inside(from_middle, -9, 0.03, f),
                   inside(y, low + 0.62 * (high - low), low + 0.62 * (high - low) + 0.05, f));
      colour = mix(colour, mix(pane, trim, bars), glass);
    }
  } else if (shop_m > 0 && v <= shop_m) {
    const float board = inside(v, 2.75, 3.3, f) * inside(u, 0.3, width - 0.3, f);
    const Vector3f paint = 0.6f * Vector3f(cell_value(1, face, p.seed), cell_value(2, face, p.seed),
                                           cell_value(3, face, p.seed));
    const float letters =
        (octaves(u, 1.3 * v, 0.23, 2, 0.6f, f, style + 41) > 0.15f ? 1.0f : 0.0f) *
        inside(v, 2.86, 3.16, f) * inside(u, 0.2 * width, 0.8 * width, f);
    const double pane_m = 1.6 + drawn(5), x = u - pane_m * std::floor(u / pane_m);
    const float window = inside(v, 0.45, 2.6, f) * inside(x, 0.12, pane_m - 0.12, f);
    const float goods = octaves(u, v, 0.45, 3, 0.8f, f, style + 51);
    colour = mix(
        colour,
        Vector3f(0.10f, 0.10f, 0.11f) + 0.1f * std::max(0.0f, goods) * Vector3f(1.2f, 1.0f, 0.7f),
        window);
    colour = mix(colour, mix(paint, Vector3f(0.7f, 0.68f, 0.6f), letters), board);
  } else if (v <= base_m && v > 0) {
    colour *= 0.6f;
  }
  return colour;
}

Vector3f car(const Primitive& p, const Hit& hit, double f) {
  const bool is_end = std::abs(hit.local.x()) / p.b.x() > std::abs(hit.local.y()) / p.b.y() &&
                      hit.normal.z()<0.5, is_top = hit.normal.z()> 0.5;
  const double u = is_end ? hit.local.y() : hit.local.x(), v = hit.local.z() + p.b.z(),
               height = 2 * p.b.z();
  Vector3f colour = p.colour * (1 + 0.08f * octaves(u, v, 0.3, 3, 0.6f, f, p.seed));
  if (p.material == Material::kCarCabin) {
    if (is_top) return colour;
    const double width = is_end ? p.b.y() : p.b.x();
    float glass = inside(v, 0.06, height - 0.09, f) * inside(std::abs(u), -9, width - 0.1, f);
    if (!is_end) glass *= 1 - lines(u, 0.95, 0.08, f);
    return mix(colour,
               Vector3f(0.06f, 0.07f, 0.08f) * (0.7f + 0.8f * static_cast<float>(v / height)),
               glass);
  }
  if (is_top)
    return colour *
           (1 - 0.5f * inside(std::abs(std::abs(hit.local.x()) - 0.3 * p.b.x()), -1, 0.012, f));
  if (is_end) {
    const bool front = hit.local.x() > 0;
    const double from_edge = p.b.y() - std::abs(u);
    const float lamp =
                    inside(from_edge, 0.08, 0.38, f) * inside(v, 0.62 * height, 0.85 * height, f),
                plate = inside(std::abs(u), -1, 0.26, f) * inside(v, 0.2, 0.32, f),
                letters = plate * (cell_value(cell_of(u / 0.05), 1, p.seed) > 0.45f ? 1.0f : 0.0f);
    colour = mix(colour, front ? Vector3f(0.6f, 0.6f, 0.56f) : Vector3f(0.5f, 0.03f, 0.02f), lamp);
    colour = mix(colour, Vector3f(0.65f, 0.64f, 0.6f) * (1 - 0.8f * letters), plate);
    if (front) colour *= 1 - 0.6f * inside(v, 0.35, 0.5, f) * inside(std::abs(u), -1, 0.5, f);
  } else {
    const double arch = std::abs(std::abs(u) - 0.62 * p.b.x());
    colour = mix(colour, Vector3f(0.02f, 0.02f, 0.02f), inside(std::hypot(arch, v), -1, 0.4, f));
    colour *= 1 - 0.6f * lines(u + 0.1, 1.05, 0.016, f) * inside(std::abs(u), -1, 1.3, f);
    colour *= 1 - 0.25f * inside(v, 0.28, 0.33, f);
    colour = mix(colour, Vector3f(0.02f, 0.02f, 0.02f),
                 lines(u - 0.35, 1.05, 0.16, f) * inside(v, 0.78 * height, 0.84 * height, f) *
                     inside(std::abs(u), -1, 1.2, f));
  }
  return colour * (1 - 0.4f * inside(v, -1, 0.12, f));
}

Vector3f poster(const Primitive& p, double u, double v, double f) {
  const double edge_m = 0.42;
  const std::int64_t x = cell_of(u / edge_m), y = cell_of(v / (1.4 * edge_m));
  const Vector3f back(0.15f + 0.5f * cell_value(x, y, p.seed),
                      0.15f + 0.5f * cell_value(x, y, p.seed + 1),
                      0.15f + 0.5f * cell_value(x, y, p.seed + 2)),
      front(cell_value(y, x, p.seed + 3), cell_value(y, x, p.seed + 4),
            cell_value(y, x, p.seed + 5));
  const auto seed = p.seed + static_cast<std::uint32_t>(13 * x + 7 * y);
  const float shape = octaves(u, v, 0.2, 3, 0.6f, f, seed) > 0.1f ? 1.0f : 0.0f,
              text = lines(v, 0.07, 0.03, f) *
                     (cell_value(cell_of(u / 0.03), cell_of(v / 0.07), seed) > 0.4f);
  const double at = part_of_cell(v / (1.4 * edge_m));
  Vector3f colour = mix(back, front, at > 0.4 ? shape : text);
  return mix(colour, Vector3f(0.55f, 0.54f, 0.5f),
             std::max(lines(u, edge_m, 0.02, f), lines(v, 1.4 * edge_m, 0.02, f)));
}

}  // namespace

Vector3f albedo(const Road& road, const Primitive& p, const Hit& hit, const Vector3d& point,
                double f) {
  const Vector3d& at = hit.local;
  // Unrolled around cylinders; along the wider side of boxes.
  const bool round = p.shape == Shape::kCylinder;
  const double u = round ? p.b.x() * std::atan2(at.y(), at.x()) : at.x() + at.y(),
               v = at.z() + p.b.z();
  Vector3f colour = p.colour;
  switch (p.material) {
    case Material::kGround: colour = ground(road, p, hit, point, f); break;
    case Material::kHouse: colour = house(p, hit, f); break;
    case Material::kCarBody:
    case Material::kCarCabin: colour = car(p, hit, f); break;
    case Material::kPoster: colour = poster(p, u, v, f); break;
    case Material::kRoof:
      colour *= (1 + 0.2f * octaves(u, v, 0.4, 4, 0.8f, f, p.seed)) *
                (1 - 0.3f * lines(v, 0.25, 0.03, f));
      break;
    case Material::kTyre:
      if (std::hypot(at.x(), at.z()) < 0.2)
        colour =
            Vector3f(0.35f, 0.35f, 0.36f) *
            (lines(std::atan2(at.z(), at.x()), 2 * std::numbers::pi / 7, 0.5, 0.1) > 0.5f ? 1.0f
                                                                                          : 0.25f);
      break;
    case Material::kBark: colour *= 1 + 0.5f * octaves(u, 0.3 * v, 0.07, 3, 0.8f, f, p.seed); break;
    case Material::kLeaves: {
      const double x = at.x() + 0.7 * at.y(), y = at.z() - 0.6 * at.y();
      const float grain = 1 + 0.5f * octaves(x, y, 0.42, 5, 0.85f, f, p.seed);
      colour *= std::max(0.15f, grain);
      break;
    }
    case Material::kSign: {
      const double ring = round ? part_of_cell(v / 0.4) : std::hypot(at.y(), at.z()) / p.b.z();
      const float white = round ? lines(v, 0.4, 0.2, f) : inside(ring, -1, 0.72, f / p.b.z());
      colour = mix(colour, Vector3f(0.68f, 0.67f, 0.65f), white);
      if (!round && ring < 0.66)
        colour *= octaves(at.y(), at.z(), 0.16, 2, 0.5f, f, p.seed) > 0.05f ? 0.12f : 1.0f;
      break;
    }
    case Material::kWood:
      colour *= (1 + 0.25f * octaves(0.2 * u, v, 0.05, 3, 0.8f, f, p.seed)) *
                (1 - 0.5f * lines(u, 0.14, 0.012, f));
      break;
    case Material::kMetal:
      colour *= 1 + 0.2f * octaves(u, v, 0.3, 4, 0.8f, f, p.seed);
      if (!round && p.b.z() > 0.3) colour *= 1 - 0.5f * lines(v, 0.31, 0.02, f);
      break;
  }
  return colour.cwiseMax(0.005f).cwiseMin(0.9f);
}

Vector3f field_albedo(const Vector3d& point, double f) { return grass(point.x(), point.y(), f); }

Vector3f sky_radiance(const Vector3d& direction, double footprint_rad) {
  const double up = std::max(direction.z(), 0.0);
  Vector3f colour = mix(Vector3f(0.60f, 0.67f, 0.75f), Vector3f(0.16f, 0.33f, 0.66f),
                        static_cast<float>(std::sqrt(up)));
  // Clouds on a plane, fading towards the horizon.
  const double height = 0.12 + up, f = footprint_rad / (height * height);
  const float cloud = std::clamp(
      0.15f + octaves(direction.x() / height, direction.y() / height, 1.3, 6, 0.6f, f, 131), 0.0f,
      1.0f);
  return mix(colour, Vector3f(0.86f, 0.86f, 0.85f), 0.8f * cloud);
}

}  // namespace redrive::drive
