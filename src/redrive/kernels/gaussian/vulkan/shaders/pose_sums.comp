// SPDX-License-Identifier: Apache-2.0
// Derivatives by the poses, [parts, 6]: sums over the drawn Gaussians of each part. A group for a
// part.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Params p;
  Floats out_sums;
  SHADOW
};
#include "races.glsl"
shared float s_sum[256];
void main() {
  const uint part = group_index(), t = gl_LocalInvocationIndex;
  if (part >= p.n_parts) return;
  const uint begin = p.parts.v[2u * part] * 16u;
  const uint end = part + 1u < p.n_parts ? min(p.parts.v[2u * part + 2u] * 16u, p.n) : p.n;
  float sum[6];
  for (int k = 0; k < 6; ++k) sum[k] = 0.0;
  const uint stop = p.control.v[2] != 0u ? begin : end;
  for (uint i = begin + t; i < stop; i += 256u) {
    if (p.depth_key.v[i] == kNotDrawn) continue;
    for (int k = 0; k < 6; ++k) sum[k] += p.sums.v[i * kSumsOfPair + k];
  }
  for (int k = 0; k < 6; ++k) {
    s_sum[W(0u, t)] = sum[k];
    sync();
    for (uint d = 128u; d > 0u; d >>= 1) {
      if (t < d) s_sum[W(0u, t)] += s_sum[R(0u, t + d)];
      sync();
    }
    if (t == 0u) out_sums.v[6u * part + k] = s_sum[R(0u, 0u)];
  }
}
