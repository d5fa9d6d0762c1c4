// SPDX-License-Identifier: Apache-2.0
// Calls every formula, so that a build compiles and checks them; no program runs it.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_GOOGLE_include_directive : require
#include "formulas.glsl"
#include "ssim.glsl"
layout(local_size_x = 64) in;
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Floats { float v[]; };
layout(push_constant) uniform Push { Floats numbers, to; };

void main() {
  PlainCamera c;
  Pose pose;
  float rows[kGaussianRows], sum[kPairSums], q[4], m[5];
  uint at = gl_GlobalInvocationID.x * 128u;
  c.fx = numbers.v[at++];
  c.fy = numbers.v[at++];
  c.cx = numbers.v[at++];
  c.cy = numbers.v[at++];
  for (int k = 0; k < 8; ++k) c.numbers[k] = numbers.v[at++];
  c.max_radius2 = numbers.v[at++];
  for (int k = 0; k < 4; ++k) q[k] = numbers.v[at++];
  rotation_from_quaternion(q, pose.rotation);
  for (int k = 0; k < 3; ++k) pose.centre[k] = numbers.v[at++];
  for (int k = 0; k < kGaussianRows; ++k) rows[k] = numbers.v[at++];
  for (int k = 0; k < kPairSums; ++k) sum[k] = numbers.v[at++];
  for (int k = 0; k < 5; ++k) m[k] = numbers.v[at++];

  at = gl_GlobalInvocationID.x * 64u;
  float mean[2], d_rows[kGaussianRows], d_pose[6], ssim, by_x, by_xx, by_xy;
  bool visible;
  Projected o;
  project_mean(c, pose, rows, mean, visible);
  for (int k = 0; k < 2; ++k) to.v[at++] = mean[k];
  to.v[at++] = float(visible);
  project_gaussian(c, pose, rows, o);
  to.v[at++] = float(o.visible);
  for (int k = 0; k < 2; ++k) to.v[at++] = o.mean[k] + o.variance[k] * o.slope[k];
  for (int k = 0; k < 3; ++k) to.v[at++] = o.conic[k] * o.colour[k];
  to.v[at++] = o.covariance + o.alpha * o.distance;
  project_adjoint(c, pose, rows, sum, d_rows, d_pose);
  for (int k = 0; k < kGaussianRows; ++k) to.v[at++] = d_rows[k];
  for (int k = 0; k < 6; ++k) to.v[at++] = d_pose[k];
  ssim_gradient(m, ssim, by_x, by_xx, by_xy);
  to.v[at++] = ssim + by_x + by_xx + by_xy;
  to.v[at++] = kSsimWeights[gl_GlobalInvocationID.x % uint(kSsimTaps)];
}
