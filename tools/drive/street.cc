// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/street.h"

#include <cmath>
#include <numbers>

#include "redrive/base/rng.h"
#include "tools/drive/streams.h"

namespace redrive::drive {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kGroundPiece_m = 3,  // whole metres: pieces of Road::knot
    kHouseLot_m = 13, kTreeLot_m = 9, kCarLot_m = 6, kLampLot_m = 28, kClutterLot_m = 4;

/// Random numbers of one lot of the road.
class Dice {
 public:
  Dice(unsigned seed, std::uint64_t stream, long lot, int side)
      : key_(random_key(
            seed, stream,
            2 * static_cast<std::uint64_t>(lot + 1'000'000'000L) + (side > 0 ? 1 : 0))) {}
  double uniform(double low, double high) {
    return low + (high - low) * random_unit(key_, drawn_++);
  }
  bool chance(double probability) { return uniform(0, 1) < probability; }
  std::uint32_t seed() { return static_cast<std::uint32_t>(random_bits(key_, drawn_++) >> 32); }
  template <std::size_t n>
  const Vector3f& any(const Vector3f (&of)[n]) {
    return of[static_cast<std::size_t>(uniform(0, 1) * n)];
  }

 private:
  std::uint64_t key_, drawn_ = 0;
};

const Vector3f kWalls[] = {{0.55f, 0.46f, 0.32f}, {0.42f, 0.18f, 0.12f}, {0.50f, 0.49f, 0.46f},
                           {0.62f, 0.58f, 0.50f}, {0.30f, 0.38f, 0.46f}, {0.56f, 0.34f, 0.22f},
                           {0.34f, 0.42f, 0.32f}, {0.46f, 0.25f, 0.18f}};
const Vector3f kPaints[] = {{0.55f, 0.55f, 0.56f}, {0.10f, 0.10f, 0.11f}, {0.45f, 0.05f, 0.04f},
                            {0.06f, 0.14f, 0.34f}, {0.62f, 0.61f, 0.58f}, {0.22f, 0.24f, 0.26f},
                            {0.08f, 0.22f, 0.14f}, {0.50f, 0.38f, 0.08f}};
const Vector3f kLeaves[] = {{0.10f, 0.22f, 0.05f}, {0.16f, 0.26f, 0.06f}, {0.07f, 0.17f, 0.06f}};
const Vector3f kThings[] = {{0.30f, 0.31f, 0.32f},
                            {0.08f, 0.24f, 0.16f},
                            {0.50f, 0.40f, 0.07f},
                            {0.48f, 0.08f, 0.05f},
                            {0.10f, 0.18f, 0.36f}};

class Furnisher {
 public:
  Furnisher(const Road& road, unsigned seed)
      : road_(road),
        seed_(seed),
        first_m_(road.loop_m() > 0 ? 0 : road.first_m()),
        last_m_(road.loop_m() > 0 ? road.loop_m() : road.last_m()) {}

  std::vector<Primitive> all() {
    ground();
    for (const int side : {-1, 1}) {
      lots(kHouseLot_m, [&](long lot) { house(lot, side); });
      lots(kTreeLot_m, [&](long lot) { tree(lot, side); });
      lots(kCarLot_m, [&](long lot) { car(lot, side); });
      lots(kLampLot_m, [&](long lot) { lamp(lot, side); });
      lots(kClutterLot_m, [&](long lot) { clutter(lot, side); });
    }
    return std::move(made_);
  }

 private:
  template <class Use>
  void lots(double size_m, const Use& use) {
    for (long lot = std::lround(std::ceil(first_m_ / size_m)) + 1;
         (static_cast<double>(lot) + 2) * size_m < last_m_; ++lot)
      use(lot);
  }

  /// Adds a primitive at a place of the road, turned with it and then by yaw. `from_z_m`: its
  /// lower end above the road.
  Primitive& add(Shape shape, Material material, double s, double t, double from_z_m,
                 const Vector3d& size_m, double yaw_rad = 0) {
    Primitive p;
    p.shape = shape;
    p.material = material;
    p.b = size_m / 2;
    p.a = road_.position(s, t, from_z_m + p.b.z());
    const double yaw = road_.heading_rad(s) + yaw_rad;
    p.cos_yaw = std::cos(yaw);
    p.sin_yaw = std::sin(yaw);
    made_.push_back(p);
    return made_.back();
  }

  void ground() {
    // Offsets and heights of the edges of the strips: verge, pavement, kerb, road and so on.
    const double edges[][2] = {{-kVergeEdge_m, kKerbHeight_m},
                               {-kPavementEdge_m, kKerbHeight_m},
                               {-kKerb_m, kKerbHeight_m},
                               {-kKerb_m, 0},
                               {kKerb_m, 0},
                               {kKerb_m, kKerbHeight_m},
                               {kPavementEdge_m, kKerbHeight_m},
                               {kVergeEdge_m, kKerbHeight_m}};
    for (long piece = std::lround(std::ceil(first_m_ / kGroundPiece_m));
         (static_cast<double>(piece) + 1) * kGroundPiece_m <= last_m_; ++piece) {
      const double s = static_cast<double>(piece) * kGroundPiece_m, end = s + kGroundPiece_m;
      for (std::size_t e = 0; e + 1 < std::size(edges); ++e) {
        const auto corner = [&](double at, std::size_t edge) {
          return road_.position(at, edges[edge][0], edges[edge][1]);
        };
        const Vector3d corners[] = {corner(s, e), corner(end, e), corner(end, e + 1),
                                    corner(s, e + 1)};
        for (const int k : {1, 2}) {
          Primitive p;
          p.shape = Shape::kTriangle;
          p.material = Material::kGround;
          p.a = corners[0], p.b = corners[k], p.c = corners[k + 1];
          p.road_s_m = s;
          p.road_length_m = kGroundPiece_m;
          made_.push_back(p);
        }
      }
    }
  }

  void house(long lot, int side) {
    Dice dice(seed_, kStreamHouses, lot, side);
    const auto border = [&](long of) {
      return kHouseLot_m * static_cast<double>(of) +
             Dice(seed_, kStreamHouses, of + 500'000'000L, side).uniform(-2.5, 2.5);
    };
    const double from = border(lot), to = border(lot + 1), s = (from + to) / 2;
    const double depth = dice.uniform(8, 12), front = kPavementEdge_m + dice.uniform(0, 1.2),
                 height = dice.uniform(5.5, 17);
    const std::uint32_t seed = dice.seed();
    const Vector3f& wall = dice.any(kWalls);
    if (dice.chance(0.12)) {  // a garden behind a wall
      Primitive& fence = add(Shape::kBox, Material::kWood, s, side * (front + 0.2), 0,
                             {to - from, 0.2, dice.uniform(1, 1.9)});
      fence.colour = wall, fence.seed = seed;
      for (int k = 0; k < 3; ++k)
        crown(s + dice.uniform(-4, 4), side * (front + dice.uniform(3, 8)), dice.uniform(2, 4.5),
              &dice);
      return;
    }
    // Outer sides of curves are longer than the centre line: houses leave wedges there.
    Primitive& body = add(Shape::kBox, Material::kHouse, s, side * (front + depth / 2), -1.5,
                          {to - from - 0.05, depth, height + 1.5});
    body.colour = wall, body.seed = seed;
    Primitive& eaves = add(Shape::kBox, Material::kRoof, s, side * (front + depth / 2), height,
                           {to - from - 0.1, depth + 0.7, 0.25});
    eaves.colour = 0.7f * wall, eaves.seed = seed;
    Primitive& roof = add(Shape::kBox, Material::kRoof, s, side * (front + depth / 2 + 1),
                          height + 0.25, {to - from - 1.5, depth - 3, dice.uniform(0.6, 2.4)});
    roof.colour = {0.28f, 0.13f, 0.09f}, roof.seed = seed + 1;
    for (int k = 0; k < 2; ++k)
      add(Shape::kBox, Material::kRoof, s + dice.uniform(-4, 4),
          side * (front + dice.uniform(2, 6)), height + 0.25, {0.6, 0.6, dice.uniform(1.5, 3)})
          .colour = {0.3f, 0.15f, 0.11f};
    const int balconies = dice.chance(0.4) ? static_cast<int>(dice.uniform(1, 5)) : 0;
    for (int k = 0; k < balconies; ++k) {
      Primitive& balcony =
          add(Shape::kBox, Material::kMetal, s + dice.uniform(-4, 4), side * (front - 0.45),
              3.3 + 3 * std::floor(dice.uniform(0, std::max(1.0, (height - 4) / 3))),
              {dice.uniform(1.5, 2.6), 0.9, 1.0});
      balcony.colour = 0.8f * wall, balcony.seed = dice.seed();
    }
  }

  /// A sphere of leaves around a point of the road.
  void crown(double s, double t, double z, Dice* dice) {
    const Vector3f& colour = dice->any(kLeaves);
    for (int k = 0; k < 5; ++k) {
      const double size = dice->uniform(1.2, 2.4);
      Primitive& leaves = add(Shape::kEllipsoid, Material::kLeaves, s + dice->uniform(-0.9, 0.9),
                              t + dice->uniform(-0.8, 0.8), z + dice->uniform(-0.6, 1.4) - size / 2,
                              {size, size * dice->uniform(0.8, 1.1), size * dice->uniform(0.7, 1)});
      leaves.colour = colour * static_cast<float>(dice->uniform(0.8, 1.25));
      leaves.seed = dice->seed();
    }
  }

  void tree(long lot, int side) {
    Dice dice(seed_, kStreamTrees, lot, side);
    if (!dice.chance(0.45)) return;
    const double s = kTreeLot_m * static_cast<double>(lot) + dice.uniform(-2, 2),
                 t = side * (kKerb_m + dice.uniform(0.7, 1)), height = dice.uniform(2.6, 3.6),
                 thickness = dice.uniform(0.2, 0.36);
    Primitive& trunk =
        add(Shape::kCylinder, Material::kBark, s, t, 0, {thickness, thickness, height + 0.8});
    trunk.colour = {0.16f, 0.12f, 0.09f}, trunk.seed = dice.seed();
    crown(s, t, height + 0.8, &dice);
  }

  void car(long lot, int side) {
    Dice dice(seed_, kStreamCars, lot, side);
    if (!dice.chance(0.55)) return;
    const double s = kCarLot_m * static_cast<double>(lot) + dice.uniform(-0.5, 0.5),
                 t = side * (kLaneEdge_m + 1.15 + dice.uniform(-0.1, 0.15)),
                 yaw = dice.uniform(-0.03, 0.03) + (side > 0 ? std::numbers::pi : 0),
                 length = dice.uniform(3.8, 4.7), width = dice.uniform(1.68, 1.85),
                 body = dice.uniform(0.62, 0.75), cabin = dice.uniform(0.5, 0.62);
    const bool van = dice.chance(0.2);
    const Vector3f& paint = dice.any(kPaints);
    const std::uint32_t seed = dice.seed();
    const double forward = side > 0 ? -1 : 1;  // its direction along the road
    Primitive& lower = add(Shape::kBox, Material::kCarBody, s, t, 0.24, {length, width, body}, yaw);
    lower.colour = paint, lower.seed = seed;
    Primitive& upper =
        add(Shape::kBox, Material::kCarCabin, s - forward * (van ? 0.2 : 0.25), t, 0.24 + body,
            {van ? 0.86 * length : 0.55 * length, width - 0.18, van ? cabin + 0.5 : cabin}, yaw);
    upper.colour = paint, upper.seed = seed;
    for (const double along : {-0.31, 0.31})
      for (const double across : {-0.5, 0.5}) {
        Primitive& wheel = add(Shape::kEllipsoid, Material::kTyre, s + along * length,
                               t + across * (width - 0.1), 0, {0.62, 0.24, 0.62}, yaw);
        wheel.colour = {0.03f, 0.03f, 0.03f}, wheel.seed = seed;
      }
  }

  void lamp(long lot, int side) {
    Dice dice(seed_, kStreamLamps, lot, side);
    const double s = kLampLot_m * (static_cast<double>(lot) + (side > 0 ? 0.5 : 0)) +
                     dice.uniform(-1, 1),
                 t = side * (kKerb_m + 0.5);
    Primitive& pole = add(Shape::kCylinder, Material::kMetal, s, t, 0, {0.16, 0.16, 7});
    pole.colour = {0.25f, 0.27f, 0.26f}, pole.seed = dice.seed();
    Primitive& arm = add(Shape::kBox, Material::kMetal, s, t - side * 0.9, 6.9, {0.1, 1.8, 0.1});
    arm.colour = pole_colour();
    add(Shape::kBox, Material::kMetal, s, t - side * 1.7, 6.75, {0.3, 0.7, 0.14}).colour =
        pole_colour();
    if (dice.chance(0.5)) {  // a sign on the pole
      Primitive& plate =
          add(Shape::kBox, Material::kSign, s - side * 0.12, t, 2.3, {0.04, 0.62, 0.62});
      plate.colour = dice.any(kThings), plate.seed = dice.seed();
    }
  }

  void clutter(long lot, int side) {
    Dice dice(seed_, kStreamClutter, lot, side);
    if (!dice.chance(0.45)) return;
    const double s = kClutterLot_m * static_cast<double>(lot) + dice.uniform(-1, 1),
                 near_kerb = side * (kKerb_m + dice.uniform(0.3, 0.5)),
                 near_houses = side * (kPavementEdge_m - dice.uniform(0.4, 0.6));
    const Vector3f& colour = dice.any(kThings);
    const std::uint32_t seed = dice.seed();
    const auto made = [&](Primitive& p) { p.colour = colour, p.seed = seed; };
    switch (static_cast<int>(dice.uniform(0, 8))) {
      case 0:
      case 1: made(add(Shape::kCylinder, Material::kSign, s, near_kerb, 0, {0.16, 0.16, 1})); break;
      case 2: made(add(Shape::kBox, Material::kMetal, s, near_kerb, 0, {0.45, 0.4, 1})); break;
      case 3:
        made(add(Shape::kBox, Material::kPoster, s, near_houses, 0,
                 {dice.uniform(0.7, 1.3), 0.45, dice.uniform(1, 1.5)}));
        break;
      case 4:
        made(add(Shape::kBox, Material::kWood, s, near_houses, 0.32, {1.7, 0.45, 0.12}));
        made(add(Shape::kBox, Material::kWood, s, near_houses + side * 0.2, 0.5, {1.7, 0.08, 0.4}));
        break;
      case 5: {
        made(add(Shape::kCylinder, Material::kMetal, s, near_kerb, 0, {0.07, 0.07, 2.9}));
        Primitive& plate =
            add(Shape::kBox, Material::kSign, s - side * 0.06, near_kerb, 2.2, {0.04, 0.6, 0.6});
        plate.colour = colour, plate.seed = seed;
        break;
      }
      case 6: made(add(Shape::kCylinder, Material::kPoster, s, near_houses, 0, {1, 1, 2.6})); break;
      default:
        made(add(Shape::kBox, Material::kWood, s, near_houses, 0, {1.2, 0.5, 0.5}));
        for (int k = 0; k < 3; ++k) {
          Primitive& bush = add(Shape::kEllipsoid, Material::kLeaves, s + 0.4 * (k - 1),
                                near_houses, 0.35, {0.55, 0.5, 0.6});
          bush.colour = dice.any(kLeaves), bush.seed = dice.seed();
        }
    }
  }

  static Vector3f pole_colour() { return {0.25f, 0.27f, 0.26f}; }

  const Road& road_;
  unsigned seed_;
  double first_m_, last_m_;  ///< ends of what is furnished: a loop once
  std::vector<Primitive> made_;
};

}  // namespace

std::vector<Primitive> furnish(const Road& road, unsigned seed) {
  return Furnisher(road, seed).all();
}

}  // namespace redrive::drive
