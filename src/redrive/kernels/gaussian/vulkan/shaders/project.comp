// SPDX-License-Identifier: Apache-2.0
// Projects Gaussians: records, and keys of those that are drawn.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "pose.glsl"
layout(local_size_x = 128) in;
layout(push_constant) uniform Push { Params p; };

void main() {
  const uint i = thread_index();
  if (i >= p.n) return;
  const uint slot = slot_of(i);
  p.depth_key.v[i] = kNotDrawn;
  float rows[kGaussianRows];
  for (int row = 0; row < 3; ++row) rows[row] = p.numbers.v[slot + row * 16];
  const PlainCamera c = camera_of(p);
  Pose pose;
  if (!pose_of(p, c, i, rows, pose)) return;
  for (int row = 3; row < kDistanceRow; ++row)
    if (is_seen(seen_by(), row)) rows[row] = p.numbers.v[slot + row * 16];
  Projected o;
  project_gaussian(c, pose, rows, o);
  const float alpha = max(o.alpha, 1e-9), log2_alpha = log2(alpha);
  // alpha falls to kMinAlpha where half the squared Mahalanobis distance is log(alpha / min).
  const float reach = max(2.0 * 0.69314718 * (log2_alpha + kLog2InverseMinAlpha), 0.0);
  const vec2 mean = vec2(o.mean[0], o.mean[1]);
  const vec2 radius = sqrt(reach * vec2(o.variance[0], o.variance[1]));
  const bool drawn = o.visible && alpha > kMinAlpha && mean.x + radius.x > p.left &&
                     mean.x - radius.x < p.right && mean.y + radius.y > p.top &&
                     mean.y - radius.y < p.bottom && o.conic[0] > 0.0 && o.conic[2] > 0.0 &&
                     abs(o.conic[1]) < 1e30;
  if (!drawn) return;
  const float half_log2e = -0.72134752;
  p.records.v[4u * i] = vec4(mean, half_log2e * o.conic[0], 2.0 * half_log2e * o.conic[1]);
  p.records.v[4u * i + 1u] =
      vec4(half_log2e * o.conic[2], log2_alpha, max(o.colour[0], 0.0), max(o.colour[1], 0.0));
  p.records.v[4u * i + 2u] =
      vec4(max(o.colour[2], 0.0), log2(o.distance) * 0.69314718, o.slope[0], o.slope[1]);
  p.records.v[4u * i + 3u] = vec4(radius, 0.0, 0.0);
  p.depth_key.v[i] = floatBitsToUint(o.distance);
}
