// SPDX-License-Identifier: Apache-2.0
// Blends a tile's Gaussians front to back, a thread for a pixel, and keeps the states in which
// segments begin.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Params p;
  Words slots;  // pairs by tile
  SHADOW
};
#include "races.glsl"
layout(constant_id = 0) const bool kCentres = false;
layout(constant_id = 1) const bool kRange = false;
const uint kBatch = kSegment;
shared vec4 s_a[kBatch], s_b[kBatch], s_c[kBatch];
shared uint s_met[64];  // [8, 8] by block: bits of the batch's Gaussians that meet it
shared uint s_live[1];

void main() {
  const uint tile = group_index(), t = gl_LocalInvocationIndex, block = t >> 5;
  if (tile >= p.tiles_x * p.tiles_y || p.wanted.v[tile] == 0u || p.control.v[2] != 0u) return;
  const uvec2 pixel = uvec2(tile % p.tiles_x, tile / p.tiles_x) * 16u + pixel_in_tile(t);
  const uint at = pixel.y * p.stride + pixel.x, plane = p.stride * p.rows;
  const float x = kCentres ? p.centre_u.v[at] : float(pixel.x);
  const float y = kCentres ? p.centre_v.v[at] : float(pixel.y);
  const uint begin = p.ranges.v[tile], end = p.ranges.v[tile + 1u];
  float through = 1.0, median = -80.0, range_error = 0.0, log_range = 0.0;
  if (kRange) log_range = p.log_range.v[at];
  vec3 rgb = vec3(0);
  uint last = end - begin;
  bool live = true;
  for (uint k = t + 1u; k * kSegment < end - begin; k += 256u)
    p.segments.v[state_of(begin, k)] = tile;
  for (uint first = begin; first < end; first += kBatch) {
    if (t == 0u) s_live[W(0u, 0u)] = 0u;
    if (t < 64u) s_met[W(1u, t)] = 0u;
    sync();
    if (live) atomicOr(s_live[A(0u, 0u)], 1u);
    if (first + t < end) {
      const uint slot = slots.v[first + t], id = p.pair_gaussian.v[slot];
      const uint blocks = p.pair_blocks.v[slot];
      for (uint b = 0u; b < 8u; ++b)
        if ((blocks >> b & 1u) != 0u) atomicOr(s_met[A(1u, b * 8u + (t >> 5))], 1u << (t & 31u));
      s_a[W(2u, t)] = p.records.v[4u * id];
      s_b[W(3u, t)] = p.records.v[4u * id + 1u];
      s_c[W(0u, 1u + t) - 1u] = p.records.v[4u * id + 2u];
    }
    sync();
    if (s_live[R(0u, 0u)] == 0u) break;
    if (first > begin) {
      const uint state = state_of(begin, (first - begin) / kSegment) * kStateFloats * 256u + t;
      p.states.v[state] = through;
      for (uint k = 0u; k < 3u; ++k) p.states.v[state + (1u + k) * 256u] = rgb[k];
      if (kRange) p.states.v[state + 4u * 256u] = range_error;
    }
    // No `if (live)` around the loop: NVIDIA's driver 580 crashes at a loop under an if in a loop.
    for (uint word = 0u; live && word < 8u; ++word)
    for (uint left = s_met[R(1u, block * 8u + word)]; left != 0u; left &= left - 1u) {
      const uint i = word * 32u + uint(findLSB(left));
      const vec4 a = s_a[R(2u, i)], b = s_b[R(3u, i)];
      const float dx = x - a.x, dy = y - a.y;
      const float log2_alpha = (a.z * dx + a.w * dy) * dx + (b.x * dy * dy + b.y);
      if (log2_alpha > -kLog2InverseMinAlpha) {
        const vec4 c = s_c[R(0u, 1u + i) - 1u];
        const float w = min(exp2(log2_alpha), kMaxAlpha) * through;
        rgb += w * vec3(b.z, b.w, c.x);
        const float here =
            c.y + clamp(c.z * dx + c.w * dy, -kMaxLogDistance, kMaxLogDistance);
        if (through > 0.5) median = here;
        if (kRange) range_error += w * min(abs(here - log_range), kMaxRangeError);
        through -= w;
        if (through < kMinTransmittance) {
          last = first + i + 1u - begin;
          live = false;
          break;
        }
      }
    }
    sync();
  }
  for (uint k = 0u; k < 3u; ++k)
    p.rgb.v[k * plane + at] = rgb[k] + through * p.background[k];
  p.transmittance.v[at] = through;
  p.depth.v[at] = median > -80.0 ? exp(median) : 0.0;
  if (kRange) p.range_error.v[at] = range_error + through * kMaxRangeError;
  p.last.v[at] = last;
}
