// SPDX-License-Identifier: Apache-2.0
// The adjoint of tile_forward for a segment of a tile: first the tiles' first segments, then the
// others by their states. Eight Gaussians at a time: a thread for a pixel finds the weight and
// the derivative by log alpha of each; then 32 threads for a Gaussian sum over the pixels, in an
// order that depends on nothing. The sums go to the pair's own place.
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
const uint kAtOnce = 8u, kSums = uint(kPairSums);
shared vec4 s_a[kAtOnce], s_b[kAtOnce], s_c[kAtOnce];
shared uint s_slot[kAtOnce], s_blocks[kAtOnce];
shared float s_buffer[4096];  // [8, 2, 256] weights and derivatives, then [88, 33] sums
shared vec4 s_pixel[256];     // derivatives by the colour, error
shared uint s_last[1], s_any[1];

vec2 centre_of(uvec2 pixel) {
  if (!kCentres) return vec2(pixel);
  const uint at = pixel.y * p.stride + pixel.x;
  return vec2(p.centre_u.v[at], p.centre_v.v[at]);
}

void main() {
  const uint t = gl_LocalInvocationIndex, block = t >> 5, lane = t & 31u;
  const uint tiles = p.tiles_x * p.tiles_y, state = group_index() - tiles;
  const bool is_first = group_index() < tiles;
  if (group_index() >= tiles + p.control.v[1] / kSegment) return;
  const uint tile = is_first ? group_index() : p.segments.v[state];
  if (tile >= tiles || p.wanted.v[tile] == 0u || p.control.v[2] != 0u) return;
  const uvec2 corner = uvec2(tile % p.tiles_x, tile / p.tiles_x) * 16u;
  const uvec2 pixel = corner + pixel_in_tile(t);
  const uint at = pixel.y * p.stride + pixel.x, plane = p.stride * p.rows;
  const vec2 centre = centre_of(pixel);
  const uint begin = p.ranges.v[tile], last = p.last.v[at];
  // Pairs of the segment, from the tile's first one on.
  const uint from = is_first ? 0u : (state - begin / kSegment + 1u) * kSegment;
  const uint end = min(p.ranges.v[tile + 1u] - begin, from + kSegment);
  const float t_all = p.transmittance.v[at];
  float through = 1.0;
  float behind = t_all > kMinTransmittance ? t_all * p.d_transmittance.v[at] : 0.0;
  float log_range = 0.0, d_range = 0.0;
  vec3 d_rgb;
  for (uint k = 0u; k < 3u; ++k) {
    d_rgb[k] = p.d_rgb.v[k * plane + at];
    behind += d_rgb[k] * p.rgb.v[k * plane + at];
  }
  if (kRange) {
    log_range = p.log_range.v[at];
    d_range = p.d_range.v[at];
    behind += d_range * p.range_error.v[at];
  }
  if (!is_first) {
    const uint of_pixel = state * kStateFloats * 256u + t;
    through = p.states.v[of_pixel];
    for (uint k = 0u; k < 3u; ++k) behind -= d_rgb[k] * p.states.v[of_pixel + (1u + k) * 256u];
    if (kRange) behind -= d_range * p.states.v[of_pixel + 4u * 256u];
  }
  s_pixel[W(1u, t)] = vec4(d_rgb, p.error.v[at]);
  if (t == 0u) s_last[W(2u, 0u)] = 0u;
  sync();
  atomicMax(s_last[A(2u, 0u)], last);
  sync();
  const uint stop = s_last[R(2u, 0u)];
  for (uint first = from; first < end; first += kAtOnce) {
    if (t < kAtOnce && first + t < end) {
      const uint slot = slots.v[begin + first + t], id = p.pair_gaussian.v[slot];
      s_slot[W(2u, 16u + t) - 16u] = slot;
      s_blocks[W(2u, 48u + t) - 48u] = first + t < stop ? p.pair_blocks.v[slot] : 0u;
      s_a[W(2u, 64u + t) - 64u] = p.records.v[4u * id];
      s_b[W(2u, 80u + t) - 80u] = p.records.v[4u * id + 1u];
      s_c[W(2u, 96u + t) - 96u] = p.records.v[4u * id + 2u];
    }
    if (t == 0u) s_any[W(2u, 1u) - 1u] = 0u;
    sync();
    const uint n = min(kAtOnce, end - first);
    bool some = false;
    for (uint i = 0u; i < n; ++i) {
      if ((s_blocks[R(2u, 48u + i) - 48u] >> block & 1u) == 0u) continue;
      float w = 0.0, by_log = 0.0;
      const vec4 a = s_a[R(2u, 64u + i) - 64u], b = s_b[R(2u, 80u + i) - 80u];
      const float dx = centre.x - a.x, dy = centre.y - a.y;
      const float log2_alpha = (a.z * dx + a.w * dy) * dx + (b.x * dy * dy + b.y);
      if (log2_alpha > -kLog2InverseMinAlpha && first + i < last) {
        const vec4 c = s_c[R(2u, 96u + i) - 96u];
        const float full = exp2(log2_alpha), alpha = min(full, kMaxAlpha);
        w = alpha * through;
        float d_w = d_rgb.x * b.z + d_rgb.y * b.w + d_rgb.z * c.x;
        if (kRange) {
          const float here =
              c.y + clamp(c.z * dx + c.w * dy, -kMaxLogDistance, kMaxLogDistance);
          d_w += d_range * min(abs(here - log_range), kMaxRangeError);
        }
        behind -= w * d_w;
        if (full < kMaxAlpha) by_log = alpha * (through * d_w - behind / (1.0 - alpha));
        through -= w;
        some = true;
      }
      s_buffer[W(0u, i * 512u + t)] = w;
      s_buffer[W(0u, i * 512u + 256u + t)] = by_log;
    }
    if (some) atomicOr(s_any[A(2u, 1u) - 1u], 1u);
    sync();
    const bool nothing = s_any[R(2u, 1u) - 1u] == 0u;  // the same for all threads
    const uint i = block;                              // the Gaussian of these 32 threads
    float sum[kSums];
    for (uint k = 0u; k < kSums; ++k) sum[k] = 0.0;
    if (!nothing && i < n) {
      const vec4 a = s_a[R(2u, 64u + i) - 64u], c = s_c[R(2u, 96u + i) - 96u];
      const uint blocks = s_blocks[R(2u, 48u + i) - 48u];
      for (uint k = 0u; k < 8u; ++k) {
        if ((blocks >> k & 1u) == 0u) continue;
        const uint q = k * 32u + lane;
        const float w = s_buffer[R(0u, i * 512u + q)];
        const float by_log = s_buffer[R(0u, i * 512u + 256u + q)];
        const uvec2 at_q = corner + pixel_in_tile(q);
        const vec2 off = centre_of(at_q) - a.xy;
        const vec4 d = s_pixel[R(1u, q)];
        sum[kSumAlpha] += by_log;
        sum[kSumX] += by_log * off.x;
        sum[kSumY] += by_log * off.y;
        sum[kSumXX] += by_log * off.x * off.x;
        sum[kSumXY] += by_log * off.x * off.y;
        sum[kSumYY] += by_log * off.y * off.y;
        sum[kSumRgb] += w * d.x;
        sum[kSumRgb + 1] += w * d.y;
        sum[kSumRgb + 2] += w * d.z;
        sum[kSumError] += w * d.w;
        if (kRange) {
          const uint of_q = at_q.y * p.stride + at_q.x;
          const float beyond =
              c.y + clamp(c.z * off.x + c.w * off.y, -kMaxLogDistance, kMaxLogDistance) -
              p.log_range.v[of_q];
          if (abs(beyond) < kMaxRangeError)
            sum[kSumLogDistance] += (beyond < 0.0 ? -w : w) * p.d_range.v[of_q];
        }
      }
    }
    sync();
    if (!nothing)
      for (uint k = 0u; k < kSums; ++k)
        s_buffer[W(0u, (i * kSums + k) * 33u + lane)] = sum[k];
    sync();
    if (t < kAtOnce * kSums) {
      const uint g = t / kSums, k = t % kSums;
      float all = 0.0;
      if (!nothing)
        for (uint j = 0u; j < 32u; ++j) all += s_buffer[R(0u, t * 33u + j)];
      if (g < n) p.pair_sums.v[s_slot[R(2u, 16u + g) - 16u] * kSumsOfPair + k] = all;
    }
    sync();
  }
}
