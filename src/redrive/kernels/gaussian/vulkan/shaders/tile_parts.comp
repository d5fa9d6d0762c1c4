// SPDX-License-Identifier: Apache-2.0
// Finds what a tile's pixels show of the objects (RasterOptions::parts), a thread for a pixel and a
// round for each object that meets the tile.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Ints { int v[]; };
layout(push_constant) uniform Push {
  Params p;
  Words slots;    // pairs by tile
  Words shown;    // plane
  Ints extents;   // [objects, 6] PartExtent
  SHADOW
};
#include "races.glsl"
layout(constant_id = 0) const bool kCentres = false;
const uint kBatch = 256u, kNone = 0xffffffffu;
shared vec4 s_a[kBatch];
shared vec2 s_b[kBatch];
shared uint s_blocks[kBatch], s_part[kBatch], s_next[1];

void main() {
  const uint tile = group_index(), t = gl_LocalInvocationIndex, block = t >> 5;
  if (tile >= p.tiles_x * p.tiles_y || p.wanted.v[tile] == 0u || p.control.v[2] != 0u) return;
  const uvec2 pixel = uvec2(tile % p.tiles_x, tile / p.tiles_x) * 16u + pixel_in_tile(t);
  const uint at = pixel.y * p.stride + pixel.x;
  const float x = kCentres ? p.centre_u.v[at] : float(pixel.x);
  const float y = kCentres ? p.centre_v.v[at] : float(pixel.y);
  const bool inside = pixel.x < p.width && pixel.y < p.height;
  const uint begin = p.ranges.v[tile], end = p.ranges.v[tile + 1u];
  if (begin == end) {
    shown.v[at] = 0u;
    return;
  }
  uint part = 0u, most_shown = 0u;
  float most = 0.0;
  do {
    if (t == 0u) s_next[W(0u, 0u)] = kNone;
    float through = 1.0, sum = 0.0, alone = 1.0;
    for (uint first = begin; first < end; first += kBatch) {
      sync();
      if (first + t < end) {
        const uint slot = slots.v[first + t], id = p.pair_gaussian.v[slot];
        const uint of = p.parts.v[2u * part_of(p, id) + 1u] >> 1;  // the object
        s_blocks[W(1u, t)] = p.pair_blocks.v[slot];
        s_part[W(2u, t)] = of;
        s_a[W(3u, t)] = p.records.v[4u * id];
        s_b[W(4u, t)] = p.records.v[4u * id + 1u].xy;
        if (of > part) atomicMin(s_next[A(0u, 0u)], of);
      }
      sync();
      const uint n = min(kBatch, end - first);
      for (uint i = 0u; i < n; ++i) {
        if ((s_blocks[R(1u, i)] >> block & 1u) == 0u) continue;
        const vec4 a = s_a[R(3u, i)];
        const vec2 b = s_b[R(4u, i)];
        const float dx = x - a.x, dy = y - a.y;
        const float log2_alpha = (a.z * dx + a.w * dy) * dx + (b.x * dy * dy + b.y);
        if (log2_alpha > -kLog2InverseMinAlpha) {
          const float alpha = min(exp2(log2_alpha), kMaxAlpha), w = alpha * through;
          if (s_part[R(2u, i)] == part) {
            sum += w;
            alone *= 1.0 - alpha;
          }
          through -= w;
        }
      }
    }
    if (part == 0u) sum += through;
    if (part == 0u || sum > most) {
      most = sum;
      most_shown = part;
    }
    if (part > 0u && inside && alone < 0.5) {
      const uint of_part = 6u * (part - 1u);
      atomicAdd(extents.v[of_part + 1u], 1);
      atomicMin(extents.v[of_part + 2u], int(pixel.x));
      atomicMin(extents.v[of_part + 3u], int(pixel.y));
      atomicMax(extents.v[of_part + 4u], int(pixel.x));
      atomicMax(extents.v[of_part + 5u], int(pixel.y));
    }
    part = s_next[R(0u, 0u)];
    sync();
  } while (part != kNone);
  shown.v[at] = most_shown;
  if (most_shown > 0u && inside) atomicAdd(extents.v[6u * (most_shown - 1u)], 1);
}
