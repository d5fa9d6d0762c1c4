// SPDX-License-Identifier: Apache-2.0
// Sizes of the dispatches that depend on a number that the device has just found: three words each,
// from word 16 + 32 * set on.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 1) in;
layout(push_constant) uniform Push {
  Words control;
  uint n_at, set, most, groups_of_row, tiles;
};
void put(uint at, uint groups) {
  const uint across = min(groups, groups_of_row);
  control.v[at] = across;
  control.v[at + 1u] = across > 0u ? (groups + across - 1u) / across : 1u;
  control.v[at + 2u] = 1u;
}
void main() {
  uint n = control.v[n_at];
  if (n > most) {  // too many: the image does not count
    control.v[2] = n;
    n = 0u;
    control.v[n_at] = 0u;
  }
  const uint base = 16u + 32u * set, groups = (n + 4095u) / 4096u;
  put(base, (n + 255u) / 256u);
  put(base + 4u, groups);
  control.v[base + 8u] = 256u * groups;
  put(base + 12u, (256u * groups + 2047u) / 2048u);
  put(base + 16u, (n + 2047u) / 2048u);
  put(base + 20u, (n + 15u) / 16u);
  put(base + 24u, (n + 63u) / 64u);
  put(base + 28u, tiles + n / kSegment);
}
