// SPDX-License-Identifier: Apache-2.0
// Draws the LiDAR returns of a training step and writes their rays, as gather_pixels.h does for
// pixels. LidarSampler (lidar_sampler.h) decides which returns are drawn and owns the source.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "redrive/base/rng.h"
#include "redrive/math/plain_trajectory.h"
#include "redrive/rays/gather_pixels.h"

namespace redrive {

/// Divergence of a LiDAR beam in rad; data sheets of common sensors give 0.1 to 0.2 degrees.
constexpr float kLidarBeamAngle_rad = 0.002f;

/// Input of gather_returns.
struct LidarSpans {
  std::span<const float> origin, direction, range_m;  ///< LidarReturns
  std::span<const std::int64_t> t_ns;
  PlainTransform global_from_world;
  std::span<const PlainFrame> recorded;  ///< frames whose poses placed the returns in the world
  std::span<const PlainFrame> poses;     ///< current poses of the frames; empty: unchanged
};

/// Parameters of one batch, made by LidarSampler::draw.
struct LidarDraw {
  std::uint64_t seed = 0,
                first = 0;  ///< index of the first ray, counted through all epochs
};

/// The batch to write, spans of RayBatch.
struct GatheredReturns {
  std::span<float> origin, direction, pixel_angle, range_m;
};

/// Returns the transform at a time from the world of the recorded poses to the world of the current
/// poses.
inline PlainTransform world_from_recorded(const LidarSpans& from, std::int64_t t_ns) {
  const PlainTransform world_from_body =
                           product(inverse(from.global_from_world), pose_at(from.poses, t_ns)),
                       body_from_global = inverse(pose_at(from.recorded, t_ns));
  return product(product(world_from_body, body_from_global), from.global_from_world);
}

/// Writes ray i of the batch.
inline void gather_return(const LidarSpans& from, const LidarDraw& draw, std::size_t i,
                          const GatheredReturns& out) {
  const std::size_t returns = from.range_m.size(), n = out.range_m.size();
  const std::uint64_t drawn = draw.first + i,
                      key = random_key(draw.seed, kStreamLidar, drawn / returns);
  const std::size_t k = permute_index(key, drawn % returns, returns);
  double origin[3], direction[3];
  for (int d = 0; d < 3; ++d) {
    origin[d] = from.origin[d * returns + k];
    direction[d] = from.direction[d * returns + k];
  }
  const bool stays = from.poses.empty();
  const PlainTransform motion = stays ? PlainTransform() : world_from_recorded(from, from.t_ns[k]);
  for (int d = 0; d < 3; ++d) {
    out.origin[d * n + i] = static_cast<float>(stays ? origin[d] : transformed(motion, origin, d));
    out.direction[d * n + i] =
        static_cast<float>(stays ? direction[d] : rotated(motion, direction, d));
  }
  out.pixel_angle[i] = kLidarBeamAngle_rad;
  out.range_m[i] = from.range_m[k];
}

/// Writes all rays of the batch.
inline void gather_returns(const LidarSpans& from, const LidarDraw& draw,
                           const GatheredReturns& out) {
  for (std::size_t i = 0; i < out.range_m.size(); ++i) gather_return(from, draw, i, out);
}

}  // namespace redrive
