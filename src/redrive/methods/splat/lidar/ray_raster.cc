// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/ray_raster.h"

#include <algorithm>
#include <cmath>

#include "redrive/camera/plain_camera.h"

namespace redrive {
namespace {

constexpr std::size_t kTileRays = kernels::kTileSide * kernels::kTileSide;
/// Rays of a side of the blocks of a tile's pixels that kernels draw together.
constexpr std::size_t kBlockSide = 4;
constexpr std::size_t kBlockRays = kBlockSide * kBlockSide;
/// Steps of an angle by which rays are ordered: 0.02 degrees of a quarter of a turn.
constexpr std::size_t kAngleSteps = 4096;
/// Farthest azimuth and elevation, rad, at which Gaussians count: short of the poles.
constexpr double kMostRadius_rad = 1.54;

/// Returns the indices of angles that range over `extent` from `low` on, ascending to a step.
std::vector<std::uint32_t> order_by(const std::vector<float>& angles, float low, float extent) {
  const float steps = static_cast<float>(kAngleSteps - 1) / std::max(extent, 1e-6f);
  std::vector<std::uint32_t> next(kAngleSteps + 1), order(angles.size());
  const auto step_of = [&](float angle) { return static_cast<std::size_t>((angle - low) * steps); };
  for (const float angle : angles) ++next[step_of(angle) + 1];
  for (std::size_t step = 0; step < kAngleSteps; ++step) next[step + 1] += next[step];
  for (std::size_t k = 0; k < angles.size(); ++k)
    order[next[step_of(angles[k])]++] = static_cast<std::uint32_t>(k);
  return order;
}

/// Sorts each run of `length` rays, whose positions are given, as `order` has them.
void sort_runs(const std::vector<std::uint32_t>& order, std::size_t length,
               std::vector<std::uint32_t>* position) {
  std::vector<std::uint32_t> next(order.size() / length + 1);
  for (std::size_t run = 0; run < next.size(); ++run)
    next[run] = static_cast<std::uint32_t>(run * length);
  for (const std::uint32_t ray : order) (*position)[ray] = next[(*position)[ray] / length]++;
}

}  // namespace

// The filter of the kernels is the beam: an even disc has a sixteenth of its width squared as
// variance along each axis.
RayRaster::RayRaster(const RayGroup& group, double beam_rad)
    : per_radian_(4 * std::sqrt(double(kScreenVariance)) / beam_rad) {
  // Cuts the rays by azimuth into strips, these by elevation into tiles of about the same height,
  // and tiles into blocks of 4 x 4 rays, as near to squares as the beams lie.
  const std::size_t n = group.rays.size(), tiles = (n + kTileRays - 1) / kTileRays;
  const auto [left, right] = std::ranges::minmax(group.azimuth);
  const auto [top, bottom] = std::ranges::minmax(group.elevation);
  const double wide = double(right - left), high = double(bottom - top);
  tiles_y_ = static_cast<int>(std::clamp(
      std::round(std::sqrt(double(tiles) * high / std::max(wide, 1e-6))), 1.0, double(tiles)));
  const std::size_t strip = tiles_y_ * kTileRays;
  tiles_x_ = static_cast<int>((n + strip - 1) / strip);
  const std::vector<std::uint32_t> by_azimuth = order_by(group.azimuth, left, right - left),
                                   by_elevation = order_by(group.elevation, top, bottom - top);
  std::vector<std::uint32_t> position(n);
  sort_runs(by_azimuth, n, &position);
  sort_runs(by_elevation, strip, &position);
  sort_runs(by_azimuth, kBlockSide * kBlockRays, &position);
  sort_runs(by_elevation, kBlockRays, &position);
  const kernels::RasterSize size = this->size();
  u_.resize(size.plane());
  v_.resize(size.plane());
  place_.resize(n);
  const auto put = [&](std::size_t at, std::size_t ray) {
    const std::size_t tile = at % strip / kTileRays, block = at % kTileRays / kBlockRays,
                      in_block = at % kBlockRays,
                      x = at / strip * kernels::kTileSide + block % kBlockSide * kBlockSide +
                          in_block % kBlockSide,
                      y = tile * kernels::kTileSide + block / kBlockSide * kBlockSide +
                          in_block / kBlockSide,
                      place = y * size.stride + x;
    u_[place] = static_cast<float>(per_radian_ * double(group.azimuth[ray]));
    v_[place] = static_cast<float>(per_radian_ * double(group.elevation[ray]));
    return static_cast<std::uint32_t>(place);
  };
  std::size_t last = 0;
  for (std::size_t ray = 0; ray < n; ++ray) {
    place_[ray] = put(position[ray], ray);
    if (position[ray] + 1 == n) last = ray;
  }
  // Places that no ray is left for repeat the last one.
  for (std::size_t at = n; at < size.plane(); ++at) put(at, last);
  key_azimuths_ = {left, right};
  for (const float azimuth : key_azimuths_) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = group.world_from_axes;
    pose.translation() = group.origin_at(double(azimuth));
    poses_.push_back(plain(pose));
    times_.push_back(group.time_at(double(azimuth)));
    if (left == right) break;
  }
}

kernels::RasterSize RayRaster::size() const {
  return kernels::raster_size(kernels::kTileSide * tiles_x_, kernels::kTileSide * tiles_y_);
}

kernels::GaussianCamera RayRaster::camera(std::span<const kernels::GaussianPart> parts) const {
  const float left = static_cast<float>(per_radian_ * double(key_azimuths_[0])),
              right = static_cast<float>(per_radian_ * double(key_azimuths_[1]));
  const kernels::RasterSize size = this->size();
  kernels::GaussianCamera camera;
  camera.camera = make_spherical_camera(per_radian_, kMostRadius_rad, size.width, size.height);
  camera.world_from_camera = poses_;
  camera.first_row = -left - 0.5f;
  camera.image_rows = std::max(right - left, 1e-3f);
  camera.parts = parts;
  camera.centres = {u_, v_};
  camera.by_column = true;
  return camera;
}

}  // namespace redrive
