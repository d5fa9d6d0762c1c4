// SPDX-License-Identifier: Apache-2.0
// Exclusive prefix sums in three passes: sums of 2048 numbers (PASS 0), their prefix sums in one
// group (1), and those within (2). No look-back, which needs progress that Vulkan does not promise.
// FLAGS: the numbers are 1 where a key is not kNotDrawn; pass 2 then lists these.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Words numbers, block_sums, control, list, keys_out;
  uint n_at, total_at, n_fixed;  // n is control[n_at], or n_fixed where that is not 0
  SHADOW
};
#include "races.glsl"
#include "scan.glsl"
uint number(uint i) {
#ifdef FLAGS
  return uint(numbers.v[i] != kNotDrawn);
#else
  return numbers.v[i];
#endif
}
void main() {
  const uint n = n_fixed != 0u ? n_fixed : control.v[n_at], t = gl_LocalInvocationIndex;
#if PASS == 1
  const uint blocks = (n + 2047u) / 2048u;
  uint all = 0u;
  for (uint first = 0u; first < blocks; first += 256u) {
    const uint v = first + t < blocks ? block_sums.v[first + t] : 0u;
    uint total;
    const uint before = before_in_group(v, total);
    if (first + t < blocks) block_sums.v[first + t] = all + before;
    all += total;
  }
  if (t == 0u) control.v[total_at] = all;
#else
  const uint first = group_index() * 2048u + t * 8u;
  if (group_index() * 2048u >= n) return;
  uint v[8], sum = 0u, total;
  for (uint k = 0u; k < 8u; ++k) {
    v[k] = first + k < n ? number(first + k) : 0u;
    sum += v[k];
  }
  uint before = before_in_group(sum, total);
#if PASS == 0
  if (t == 0u) block_sums.v[group_index()] = total;
#else
  before += block_sums.v[group_index()];
  for (uint k = 0u; k < 8u; ++k) {
#ifdef FLAGS
    if (v[k] != 0u) {
      list.v[before] = first + k;
      keys_out.v[before] = numbers.v[first + k];
    }
#else
    if (first + k < n) numbers.v[first + k] = before;
#endif
    before += v[k];
  }
#endif
#endif
}
