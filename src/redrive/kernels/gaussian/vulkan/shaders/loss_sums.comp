// SPDX-License-Identifier: Apache-2.0
// Sums over the tiles of an image's loss, in one group, and whether all that count are finite.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Floats tile_sums, sums;  // [tiles, 16] by LossSum, [16]
  Words control;
  uint tiles;
  SHADOW
};
#include "races.glsl"
shared float s_sum[256];
shared uint s_wrong[16];
void main() {
  const uint t = gl_LocalInvocationIndex;
  if (group_index() > 0u) return;
  float sum = 0.0;
  for (uint i = t; i < 16u * tiles; i += 256u) sum += tile_sums.v[i];
  s_sum[W(0u, t)] = sum;
  sync();
  if (t < 16u) {
    sum = 0.0;
    for (uint j = 0u; j < 16u; ++j) sum += s_sum[R(0u, 16u * j + t)];
    sums.v[t] = sum;
    const bool counts = t < 3u || t == 10u || t == 11u;
    s_wrong[W(1u, t)] = uint(counts && (isnan(sum) || isinf(sum)));
  }
  sync();
  if (t > 0u) return;
  uint wrong = 0u;
  for (uint j = 0u; j < 16u; ++j) wrong |= s_wrong[R(1u, j)];
  control.v[3] = wrong;
}
