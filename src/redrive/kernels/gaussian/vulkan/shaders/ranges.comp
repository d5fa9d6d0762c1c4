// SPDX-License-Identifier: Apache-2.0
// First sorted pair of each tile [tiles + 1]. There are ranges of no pair before the dispatch.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Params p;
  Words tiles;
};
void main() {
  const uint i = thread_index(), n = p.control.v[1], end = p.tiles_x * p.tiles_y;
  if (i >= n) return;
  const uint tile = min(tiles.v[i], end), next = i + 1u < n ? min(tiles.v[i + 1u], end) : end;
  if (i == 0u)
    for (uint k = 0u; k <= tile; ++k) p.ranges.v[k] = 0u;
  for (uint k = tile + 1u; k <= next; ++k) p.ranges.v[k] = i + 1u;
}
