// SPDX-License-Identifier: Apache-2.0
// Sums over the pairs of each drawn Gaussian in the order of their making: 16 threads for one, all
// 256 of the group for one with more than kFew pairs.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Params p;
  SHADOW
};
#include "races.glsl"
const uint kFew = 32u;
shared float s_part[256];
void main() {
  const uint t = gl_LocalInvocationIndex, k = t % 16u, mine = t / 16u;
  if (p.control.v[2] != 0u) return;
  const uint drawn = p.control.v[0], first_of_group = group_index() * 16u;
  for (uint g = 0u; g < 16u; ++g) {
    const uint i = first_of_group + g;
    if (i >= drawn) break;  // the same for all threads
    const uint id = p.drawn.v[i];
    const vec4 d = p.records.v[4u * id + 3u];
    const uint first = floatBitsToUint(d.z), n = floatBitsToUint(d.w);
    const bool large = n > kFew;
    // Of a small one only its own threads add, all pairs; of a large one every 16th pair.
    const uint step = large ? 16u : 1u, from = large ? mine : mine == g ? 0u : n;
    float sum = 0.0;
    if (k < uint(kPairSums))
      for (uint j = from; j < n; j += step) sum += p.pair_sums.v[(first + j) * kSumsOfPair + k];
    if (large) {
      s_part[W(0u, t)] = sum;
      sync();
      sum = 0.0;
      for (uint j = 0u; j < 16u; ++j) sum += s_part[R(0u, 16u * j + k)];
      sync();
    }
    if (mine == g) p.sums.v[id * kSumsOfPair + k] = sum;
  }
}
