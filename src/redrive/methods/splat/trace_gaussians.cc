// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/trace_gaussians.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "redrive/camera/plain_camera.h"
#include "redrive/math/rigid3.h"
#include "redrive/methods/splat/ray_groups.h"

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

/// A group's rays as pixels of a raster, neighbours in a tile.
struct RayTiles {
  int tiles_x = 0, tiles_y = 0;
  std::vector<float> u, v;           ///< planes of centres
  std::vector<std::uint32_t> place;  ///< one per ray of the group: its place in the planes

  kernels::RasterSize size() const {
    return kernels::raster_size(kernels::kTileSide * tiles_x, kernels::kTileSide * tiles_y);
  }
};

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

/// Cuts the rays by azimuth into strips, these by elevation into tiles of about the same height,
/// and tiles into blocks of 4 x 4 rays, as near to squares as the beams lie.
RayTiles make_tiles(const RayGroup& group, double per_radian) {
  RayTiles out;
  const std::size_t n = group.rays.size(), tiles = (n + kTileRays - 1) / kTileRays;
  const auto [left, right] = std::ranges::minmax(group.azimuth);
  const auto [top, bottom] = std::ranges::minmax(group.elevation);
  const double wide = double(right - left), high = double(bottom - top);
  out.tiles_y = static_cast<int>(std::clamp(
      std::round(std::sqrt(double(tiles) * high / std::max(wide, 1e-6))), 1.0, double(tiles)));
  const std::size_t strip = out.tiles_y * kTileRays;
  out.tiles_x = static_cast<int>((n + strip - 1) / strip);
  const std::vector<std::uint32_t> by_azimuth = order_by(group.azimuth, left, right - left),
                                   by_elevation = order_by(group.elevation, top, bottom - top);
  std::vector<std::uint32_t> position(n);
  sort_runs(by_azimuth, n, &position);
  sort_runs(by_elevation, strip, &position);
  sort_runs(by_azimuth, kBlockSide * kBlockRays, &position);
  sort_runs(by_elevation, kBlockRays, &position);
  const kernels::RasterSize size = out.size();
  out.u.resize(size.plane());
  out.v.resize(size.plane());
  out.place.resize(n);
  const auto put = [&](std::size_t at, std::size_t ray) {
    const std::size_t tile = at % strip / kTileRays, block = at % kTileRays / kBlockRays,
                      in_block = at % kBlockRays,
                      x = at / strip * kernels::kTileSide + block % kBlockSide * kBlockSide +
                          in_block % kBlockSide,
                      y = tile * kernels::kTileSide + block / kBlockSide * kBlockSide +
                          in_block / kBlockSide,
                      place = y * size.stride + x;
    out.u[place] = static_cast<float>(per_radian * double(group.azimuth[ray]));
    out.v[place] = static_cast<float>(per_radian * double(group.elevation[ray]));
    return static_cast<std::uint32_t>(place);
  };
  std::size_t last = 0;
  for (std::size_t ray = 0; ray < n; ++ray) {
    out.place[ray] = put(position[ray], ray);
    if (position[ray] + 1 == n) last = ray;
  }
  // Places that no ray is left for repeat the last one.
  for (std::size_t at = n; at < size.plane(); ++at) put(at, last);
  return out;
}

/// Draws a group's rays.
void trace_group(kernels::GaussianStages& stages, const kernels::Gaussians& gaussians,
                 const kernels::Rays& rays, const RayGroup& group, const RayTiles& tiles,
                 double per_radian, RenderedRays* out) {
  const auto [left, right] = std::ranges::minmax(group.azimuth);
  const kernels::RasterSize size = tiles.size();
  std::vector<PlainPose> poses;
  for (const float azimuth : {left, right}) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = group.world_from_axes;
    pose.translation() = group.origin_at(double(azimuth));
    poses.push_back(plain(pose));
  }
  if (left == right || group.by_azimuth_m.isZero()) poses.resize(1);
  const float first = static_cast<float>(per_radian * double(left)),
              width = static_cast<float>(per_radian * double(right - left));
  kernels::GaussianCamera camera;
  camera.camera = make_spherical_camera(per_radian, kMostRadius_rad, size.width, size.height);
  camera.world_from_camera = poses;
  camera.first_row = -first - 0.5f;
  camera.image_rows = std::max(width, 1e-3f);
  camera.centres = {tiles.u, tiles.v};
  camera.by_column = true;
  kernels::RasterOptions options;
  options.depth = true;
  const kernels::Raster raster = stages.rasterise(camera, gaussians, options);
  const kernels::RasterImage& image = raster.image();
  for (std::size_t k = 0; k < group.rays.size(); ++k) {
    const std::size_t ray = group.rays[k], place = tiles.place[k];
    const Eigen::Vector3d drawn_from = group.origin_at(double(group.azimuth[k]));
    double ahead = 0;  // the drawn origin before the ray's own
    for (std::size_t axis = 0; axis < 3; ++axis)
      ahead += (drawn_from[axis] - double(rays.origin[axis * rays.n + ray])) *
               double(rays.direction[axis * rays.n + ray]);
    const float depth = image.depth[place];
    out->depth[ray] = depth > 0 ? std::max(0.0f, depth + static_cast<float>(ahead)) : 0.0f;
    out->opacity[ray] = 1 - image.transmittance[place];
  }
}

}  // namespace

RenderedRays trace_gaussians(kernels::GaussianStages& stages, ThreadPool& pool,
                             const kernels::Gaussians& gaussians, const kernels::Rays& rays,
                             double beam_rad) {
  const auto n = static_cast<std::size_t>(rays.n);
  RenderedRays out{std::vector<float>(n), std::vector<float>(n)};
  // The filter of the kernels is the beam: an even disc has a sixteenth of its width squared as
  // variance along each axis.
  const double per_radian = 4 * std::sqrt(double(kScreenVariance)) / beam_rad;
  const std::vector<RayGroup> groups = group_rays(rays, pool);
  std::vector<RayTiles> tiles(groups.size());
  pool.run(static_cast<int>(groups.size()),
           [&](int g) { tiles[g] = make_tiles(groups[g], per_radian); });
  for (std::size_t g = 0; g < groups.size(); ++g)
    trace_group(stages, gaussians, rays, groups[g], tiles[g], per_radian, &out);
  return out;
}

}  // namespace redrive
