// SPDX-License-Identifier: Apache-2.0
// The adjoint of the projection of drawn Gaussians: derivatives by their numbers, errors, and in
// place of the sums the derivatives by the pose.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "pose.glsl"
layout(local_size_x = 64) in;
layout(push_constant) uniform Push {
  Params p;
  uint with_pose;
};
void main() {
  const uint i = thread_index();
  if (i >= p.control.v[0] || p.control.v[2] != 0u) return;
  const uint id = p.drawn.v[i], slot = slot_of(id);
  float rows[kGaussianRows], sum[kPairSums], d_rows[kGaussianRows], d_pose[6];
  for (int row = 0; row < kDistanceRow; ++row)
    if (is_seen(seen_by(), row)) rows[row] = p.numbers.v[slot + row * 16];
  for (int k = 0; k < kPairSums; ++k) sum[k] = p.sums.v[id * kSumsOfPair + k];
  const PlainCamera c = camera_of(p);
  Pose pose;
  pose_of(p, c, id, rows, pose);
  project_adjoint(c, pose, rows, sum, d_rows, d_pose);
  for (int row = 0; row < kDistanceRow; ++row)
    if (is_seen(seen_by(), row)) p.gradients.v[slot + row * 16] = d_rows[row];
  p.errors.v[id] = sum[kSumError];
  if (with_pose != 0u)
    for (int k = 0; k < 6; ++k) p.sums.v[id * kSumsOfPair + k] = d_pose[k];
}
