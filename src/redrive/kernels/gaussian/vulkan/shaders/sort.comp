// SPDX-License-Identifier: Apache-2.0
// A pass of a stable radix sort of 8 bits. SCATTER 0: counts [256, groups]; 1: places, given their
// prefix sums. Ranks come from bit masks in shared memory, whatever the width of a subgroup.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Words keys, values, keys_out, values_out, counts, control;
  uint n_at, shift, iota;  // iota: values are 0, 1, ...
  SHADOW
};
#include "races.glsl"
shared uint s_count[256];
#if SCATTER
shared uint s_mask[8 * 256];
#endif
void main() {
  const uint n = control.v[n_at], groups = (n + 4095u) / 4096u, group = group_index();
  const uint t = gl_LocalInvocationIndex, first = group * 4096u;
  if (group >= groups) return;
#if SCATTER
  s_count[W(0u, t)] = counts.v[t * groups + group];
  for (uint w = 0u; w < 8u; ++w) s_mask[W(1u, w * 256u + t)] = 0u;
  sync();
  for (uint round = 0u; round < 16u; ++round) {
    const uint i = first + round * 256u + t, word = (t >> 5) * 256u;
    uint key = 0u, digit = 0u;
    if (i < n) {
      key = keys.v[i];
      digit = key >> shift & 255u;
      atomicOr(s_mask[A(1u, word + digit)], 1u << (t & 31u));
    }
    sync();
    if (i < n) {
      uint rank = s_count[R(0u, digit)] +
                  bitCount(s_mask[R(1u, word + digit)] & ((1u << (t & 31u)) - 1u));
      for (uint w = 0u; w < t >> 5; ++w) rank += bitCount(s_mask[R(1u, w * 256u + digit)]);
      keys_out.v[rank] = key;
      values_out.v[rank] = iota != 0u ? i : values.v[i];
    }
    sync();
    for (uint w = 0u; w < 8u; ++w) {
      s_count[W(0u, t)] += bitCount(s_mask[R(1u, w * 256u + t)]);
      s_mask[W(1u, w * 256u + t)] = 0u;
    }
    sync();
  }
#else
  s_count[W(0u, t)] = 0u;
  sync();
  for (uint round = 0u; round < 16u; ++round) {
    const uint i = first + round * 256u + t;
    if (i < n) atomicAdd(s_count[A(0u, keys.v[i] >> shift & 255u)], 1u);
  }
  sync();
  counts.v[t * groups + group] = s_count[R(0u, t)];
#endif
}
