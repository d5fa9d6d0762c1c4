// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/world.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "redrive/base/error.h"
#include "tools/drive/street.h"
#include "tools/drive/textures.h"

namespace redrive::drive {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

const Vector3d kToSun = Vector3d(-0.38, 0.52, 0.76).normalized();
const Vector3f kSunlight(1.05f, 0.98f, 0.86f), kSkylight(0.42f, 0.47f, 0.55f);
constexpr double kFields_m = -3;         // height of the fields around the street
constexpr double kShadowStart_m = 2e-3;  // a shadow ray must not hit the surface it starts from
constexpr float kLargest = 2;            // radiance that still differs

/// IEC 61966-2-1, linear to sRGB, for steps of kLargest / (n - 1).
const std::array<float, 8192>& transfer() {
  static const std::array<float, 8192> table = [] {
    std::array<float, 8192> t{};
    for (std::size_t i = 0; i < t.size(); ++i) {
      // Linear up to 0.6, then a shoulder: 0.6 + 0.4 (1 - exp(-(x - 0.6) / 0.4)), as tools/street.
      double x = kLargest * static_cast<double>(i) / static_cast<double>(t.size() - 1);
      if (x > 0.6) x = 0.6 + 0.4 * (1 - std::exp(-(x - 0.6) / 0.4));
      t[i] = static_cast<float>(
          255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055));
    }
    return t;
  }();
  return table;
}

std::uint8_t displayed(float radiance) {
  const std::array<float, 8192>& table = transfer();
  const float at = std::clamp(radiance / kLargest, 0.0f, 1.0f) * (table.size() - 1);
  return static_cast<std::uint8_t>(std::lround(table[static_cast<std::size_t>(at)]));
}

}  // namespace

World::World(unsigned seed, double first_m, double last_m, double loop_m)
    : road_(seed, first_m, last_m, loop_m), caster_(furnish(road_, seed)) {}

Hit World::nearest(const Vector3d& origin, const Vector3d& direction) const {
  Hit hit = caster_.cast(origin, direction);
  if (hit.found() || direction.z() >= 0) return hit;
  hit.distance_m = (kFields_m - origin.z()) / direction.z();
  return hit;
}

World::Return World::range(const Vector3d& origin, const Vector3d& direction) const {
  const Hit hit = nearest(origin, direction);
  if (!std::isfinite(hit.distance_m)) return {hit.distance_m, 0};
  constexpr double kSpot_m = 0.03;
  const Vector3d point = origin + hit.distance_m * direction;
  return {hit.distance_m,
          (hit.found() ? albedo(road_, caster_.primitives()[hit.primitive], hit, point, kSpot_m)
                       : field_albedo(point, kSpot_m))
              .mean()};
}

Vector3f World::radiance(const Vector3d& origin, std::span<const Vector3d> directions,
                         double footprint_rad) const {
  constexpr std::size_t kMost = CameraRays::kSamples;
  REDRIVE_CHECK(!directions.empty() && directions.size() <= kMost);
  std::array<Hit, kMost> hits;
  std::array<bool, kMost> in_sun{};
  const std::size_t n = directions.size();
  bool is_one_surface = true;
  for (std::size_t k = 0; k < n; ++k) {
    hits[k] = nearest(origin, directions[k]);
    is_one_surface = is_one_surface && hits[k].found() && hits[k].primitive == hits[0].primitive &&
                     hits[k].normal.dot(hits[0].normal) > 0.9;
  }
  const auto look_up = [&](std::size_t k) {
    return hits[k].normal.dot(kToSun) > 0 &&
           !caster_.is_occluded(
               origin + hits[k].distance_m * directions[k] + kShadowStart_m * hits[k].normal,
               kToSun);
  };
  if (is_one_surface && (in_sun[0] = look_up(0)) == (in_sun[n - 1] = look_up(n - 1)))
    in_sun.fill(in_sun[0]);
  else
    for (std::size_t k = 0; k < n; ++k) in_sun[k] = std::isfinite(hits[k].distance_m) && look_up(k);

  Vector3f sum = Vector3f::Zero();
  for (std::size_t k = 0; k < n; ++k) {
    const Hit& hit = hits[k];
    if (!std::isfinite(hit.distance_m)) {
      sum += sky_radiance(directions[k], footprint_rad);
      continue;
    }
    const Vector3d point = origin + hit.distance_m * directions[k];
    // Across the ray times the square root of the stretch along it.
    const double cosine = std::max(0.02, -hit.normal.dot(directions[k])),
                 footprint_m = hit.distance_m * footprint_rad / std::sqrt(cosine);
    const Vector3f colour =
        hit.found() ? albedo(road_, caster_.primitives()[hit.primitive], hit, point, footprint_m)
                    : field_albedo(point, footprint_m);
    Vector3f light = kSkylight * static_cast<float>(0.65 + 0.35 * hit.normal.z());
    if (in_sun[k]) light += kSunlight * static_cast<float>(hit.normal.dot(kToSun));
    sum += colour.cwiseProduct(light);
  }
  return sum / static_cast<float>(n);
}

CameraRays::CameraRays(const Camera& camera) : width_(camera.width), height_(camera.height) {
  // A rotated grid: each row and column of a fourth of the pixel has one sample.
  constexpr double kOffsets[kSamples][2] = {
      {-0.125, -0.375}, {0.375, -0.125}, {-0.375, 0.125}, {0.125, 0.375}};
  const std::size_t pixels = std::size_t(width_) * height_;
  samples_.assign(kSamples * pixels, Vector3f::Zero());
  centres_.assign(pixels, Vector3d::Zero());
  for (std::size_t p = 0; p < pixels; ++p) {
    const Eigen::Vector2d pixel(static_cast<double>(p % std::size_t(width_)),
                                static_cast<double>(p / std::size_t(width_)));
    const auto centre = camera.unproject(pixel);
    if (!centre) continue;
    centres_[p] = *centre;
    for (int k = 0; k < kSamples; ++k)
      if (const auto sample =
              camera.unproject(pixel + Eigen::Vector2d(kOffsets[k][0], kOffsets[k][1])))
        samples_[kSamples * p + k] = sample->cast<float>();
  }
  footprint_rad_ = 0.5 / std::max(camera.fx, camera.fy);
}

Image8 draw(const World& world, const CameraRays& rays, const Rigid3d& world_from_camera,
            double gain) {
  Image8 image{rays.width(), rays.height(), {}, {}, {}};
  image.rgb.assign(3 * rays.centres().size(), 0);
  for (std::size_t p = 0; p < rays.centres().size(); ++p) {
    if (rays.centres()[p].isZero()) continue;
    std::array<Vector3d, CameraRays::kSamples> directions;
    std::size_t seen = 0;
    for (std::size_t k = 0; k < CameraRays::kSamples; ++k) {
      const Vector3f& in_camera = rays.samples()[CameraRays::kSamples * p + k];
      if (in_camera.isZero()) continue;
      directions[seen++] = (world_from_camera.linear() * in_camera.cast<double>()).normalized();
    }
    if (seen == 0) continue;
    const Vector3f mean = world.radiance(world_from_camera.translation(), {directions.data(), seen},
                                         rays.footprint_rad());
    for (int c = 0; c < 3; ++c)
      image.rgb[3 * p + c] = displayed(static_cast<float>(gain) * mean[c]);
  }
  return image;
}

Image16 draw_depth(const World& world, const CameraRays& rays, const Rigid3d& world_from_camera) {
  Image16 depth{rays.width(), rays.height(), {}};
  depth.values.assign(rays.centres().size(), 0);
  for (std::size_t p = 0; p < rays.centres().size(); ++p) {
    if (rays.centres()[p].isZero()) continue;
    const double distance_m =
        world.range(world_from_camera.translation(), world_from_camera.linear() * rays.centres()[p])
            .distance_m;
    if (std::isfinite(distance_m))
      depth.values[p] =
          static_cast<std::uint16_t>(std::lround(std::clamp(1000 * distance_m, 0.0, 65535.0)));
  }
  return depth;
}

}  // namespace redrive::drive
