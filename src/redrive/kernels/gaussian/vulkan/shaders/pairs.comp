// SPDX-License-Identifier: Apache-2.0
// Pairs of drawn Gaussians with tiles, by distance. EMIT 0: counts them; 1: writes them, given
// their prefix sums; keys that are not written stay beyond all tiles. A thread for a Gaussian; all
// threads of a group for one that may meet more than kFew tiles.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Params p;
  Words tiles;  // by pair
  SHADOW
};
#include "races.glsl"
layout(constant_id = 0) const bool kCentres = false;
const uint kFew = 16u;
shared uint s_large[8], s_met[8];

struct TileRect {
  uint x0, y0, across, n;  // n: number of tiles
};
// Returns the first of the n ascending numbers that is at least x; n: none is.
uint first_from(uint at, uint n, float x) {
  uint found = 0u;
  for (uint step = 1u << 15; step > 0u; step >>= 1)
    if (found + step <= n && p.extents.v[at + found + step - 1u] < x) found += step;
  return found;
}
TileRect tiles_of(vec2 mean, vec2 radius) {
  uint x0, x1, y0, y1;  // the ends are exclusive
  if (kCentres) {
    const uint v = 2u * p.tiles_x;
    x0 = first_from(p.tiles_x, p.tiles_x, mean.x - radius.x);
    x1 = first_from(0u, p.tiles_x, mean.x + radius.x);
    y0 = first_from(v + p.tiles_y, p.tiles_y, mean.y - radius.y);
    y1 = first_from(v, p.tiles_y, mean.y + radius.y);
  } else {
    const vec2 most = vec2(float(p.tiles_x - 1u), float(p.tiles_y - 1u));
    const vec2 low = clamp((mean - radius + 0.5) / 16.0, vec2(0), most);
    const vec2 high = clamp((mean + radius + 0.5) / 16.0, vec2(0), most);
    x0 = uint(low.x);
    x1 = uint(high.x) + 1u;
    y0 = uint(low.y);
    y1 = uint(high.y) + 1u;
  }
  const uint across = x1 > x0 ? x1 - x0 : 0u, down = y1 > y0 ? y1 - y0 : 0u;
  return TileRect(x0, y0, across, across * down);
}
uint tile_of(TileRect rect, uint k) {
  return (rect.y0 + k / rect.across) * p.tiles_x + rect.x0 + k % rect.across;
}
// Which blocks of a tile the Gaussian meets; 0 where the tile is not wanted. The falloff is
// greatest on the sides nearest to the mean.
uint blocks_met(vec4 a, float yy, float peak, uint tile) {
  if (p.wanted.v[tile] == 0u) return 0u;
  const float xx = a.z, xy = a.w, best_x = -0.5 * xy / xx, best_y = -0.5 * xy / yy;
  const vec2 corner = vec2(float(tile % p.tiles_x * 16u), float(tile / p.tiles_x * 16u)) - a.xy;
  uint bits = 0u;
  for (uint b = 0u; b < 8u; ++b) {
    float x0, x1, y0, y1;
    if (kCentres) {
      const uint box = 32u * tile + b;
      x0 = p.boxes.v[box] - a.x;
      x1 = p.boxes.v[box + 8u] - a.x;
      y0 = p.boxes.v[box + 16u] - a.y;
      y1 = p.boxes.v[box + 24u] - a.y;
    } else {
      x0 = corner.x + float((b & 1u) * 8u);
      x1 = x0 + 7.0;
      y0 = corner.y + float((b >> 1) * 4u);
      y1 = y0 + 3.0;
    }
    const float side_x = clamp(0.0, x0, x1), side_y = clamp(0.0, y0, y1);
    const float y = clamp(best_y * side_x, y0, y1), x = clamp(best_x * side_y, x0, x1);
    precise const float highest = max((xx * side_x + xy * y) * side_x + yy * y * y,
                                      (xx * x + xy * side_y) * x + yy * side_y * side_y);
    bits |= uint(highest + peak > -kLog2InverseMinAlpha) << b;
  }
  return bits;
}
void put(uint at, uint end, uint gaussian, uint tile, uint bits) {
  if (at < end) {
    tiles.v[at] = tile;
    p.pair_gaussian.v[at] = gaussian;
    p.pair_blocks.v[at] = bits;
  }
}

void main() {
  const uint t = gl_LocalInvocationIndex, i = thread_index(), drawn = p.control.v[0];
#if EMIT
  if (p.control.v[2] != 0u) return;
#endif
  uint id = 0u, made = 0u, first = 0u, end = 0u;
  vec4 a = vec4(0), b = vec4(0);
  TileRect rect = TileRect(0u, 0u, 0u, 0u);
  if (i < drawn) {
    id = p.by_depth.v[i];
    a = p.records.v[4u * id];
    b = p.records.v[4u * id + 1u];
    rect = tiles_of(a.xy, p.records.v[4u * id + 3u].xy);
#if EMIT
    first = p.pair_first.v[i];
    end = first + floatBitsToUint(p.records.v[4u * id + 3u].w);
#endif
  }
  const uint alone = rect.n <= kFew ? rect.n : 0u;
  for (uint k = 0u; k < alone; ++k) {
    const uint tile = tile_of(rect, k), bits = blocks_met(a, b.x, b.y, tile);
    if (bits == 0u) continue;
#if EMIT
    put(first + made, end, id, tile, bits);
#endif
    ++made;
  }
  if (t < 8u) s_large[W(0u, t)] = 0u;
  sync();
  if (rect.n > kFew) atomicOr(s_large[A(0u, t >> 5)], 1u << (t & 31u));
  sync();
  // The Gaussians of the group that are large, one after another: the same for all its threads.
  for (uint word = 0u; word < 8u; ++word)
  for (uint left = s_large[R(0u, word)]; left != 0u; left &= left - 1u) {
    const uint j = word * 32u + uint(findLSB(left));
    const uint other = group_index() * 256u + j, its = p.by_depth.v[other];
    const vec4 its_a = p.records.v[4u * its], its_b = p.records.v[4u * its + 1u];
    const vec4 its_d = p.records.v[4u * its + 3u];
    const TileRect its_rect = tiles_of(its_a.xy, its_d.xy);
    uint its_made = 0u;
    for (uint from = 0u; from < its_rect.n; from += 256u) {
      const uint k = from + t, tile = tile_of(its_rect, min(k, its_rect.n - 1u));
      const uint bits = k < its_rect.n ? blocks_met(its_a, its_b.x, its_b.y, tile) : 0u;
      if (t < 8u) s_met[W(1u, t)] = 0u;
      sync();
      if (bits != 0u) atomicOr(s_met[A(1u, t >> 5)], 1u << (t & 31u));
      sync();
      uint before = 0u, all = 0u;
      for (uint w = 0u; w < 8u; ++w) {
        const uint met = s_met[R(1u, w)];
        all += bitCount(met);
        before += w < t >> 5 ? bitCount(met)
                             : w == t >> 5 ? bitCount(met & ((1u << (t & 31u)) - 1u)) : 0u;
      }
#if EMIT
      const uint its_first = p.pair_first.v[other];
      if (bits != 0u)
        put(its_first + its_made + before, its_first + floatBitsToUint(its_d.w), its, tile, bits);
#endif
      its_made += all;
      sync();
    }
    if (t == j) made = its_made;
  }
  if (i >= drawn) return;
#if EMIT
  p.records.v[4u * id + 3u].zw =
      vec2(uintBitsToFloat(first), uintBitsToFloat(min(made, end - first)));
#else
  p.pair_first.v[i] = made;
  p.records.v[4u * id + 3u].w = uintBitsToFloat(made);
#endif
}
