// SPDX-License-Identifier: Apache-2.0
// L1 and D-SSIM of an image with gains and a mask against ground truth of 8 bits, its transmittance
// and its range errors, in tiles of 16 x 16 pixels. PASS 0: sums, and slopes of SSIM by windows'
// moments, not yet divided by the number of pixels; 1: derivatives by the pixels, after loss_sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "ssim.glsl"
layout(local_size_x = 256) in;
// VulkanLoss::Parameters has the same layout.
layout(buffer_reference, std430, buffer_reference_align = 16) buffer Loss {
  Floats rgb, gains;  // gains: [3, gain_rows, gain_columns] in cells of the whole image
  Floats transmittance, range_error, log_range;
  Words target, alpha, used;  // bytes of rows of the whole width, from first_row on
  Floats slopes;              // 9 planes
  Floats d_rgb, d_transmittance, error, d_range;
  Floats tile_sums, sums;  // [tiles, 16] by LossSum, [16] of the image
  Floats patches;          // [patches, 9]: pixels, target, rendered
  uint width, height, stride, rows, tiles_x, target_width, target_x, target_y, first_row;
  uint has_alpha, has_used, has_pixels, has_ranges;  // has_pixels: transmittance counts
  uint gain_columns, gain_rows;
  float cells_by_x, cells_by_y;
  float l1_weight, ssim_weight, transmittance_weight, range_each;
  float background_change[3];
};
layout(push_constant) uniform Push {
  Loss p;
  SHADOW
};
#include "races.glsl"
const uint kHalo = uint(kSsimRadius), kSide = 16u + 2u * kHalo, kColumns = kSide * 16u;
shared float s_x[kSide * kSide], s_y[kSide * kSide];
#if PASS == 0
const uint kMoments = 5u, kValues = 8u;
shared float s_value[kValues * 256u], s_part[256], s_patch[32];
#else
const uint kMoments = 3u;
shared float s_z[kSide * kSide];
#endif
shared float s_m[kMoments * kColumns];

uint target_pixel(uint x, uint y) {
  return (p.target_y - p.first_row + y) * p.target_width + p.target_x + x;
}
float mask_at(uint x, uint y) {
  return p.has_used != 0u ? float(min(byte_of(p.used, target_pixel(x, y)), 1u)) : 1.0;
}
// field/shading.h: bilinear between the centres of cells, constant beyond the outermost.
float gain_at(uint c, uint x, uint y) {
  const uvec2 cells = uvec2(p.gain_columns, p.gain_rows);
  const vec2 pixel = vec2(p.target_x + x, p.target_y + y) + 0.5;
  const vec2 at =
      clamp(pixel * vec2(p.cells_by_x, p.cells_by_y) - 0.5, vec2(0), vec2(cells - 1u));
  const uvec2 a = uvec2(at), b = min(a + 1u, cells - 1u);
  const vec2 w = at - vec2(a);
  const uint above = (c * cells.y + a.y) * cells.x, below = (c * cells.y + b.y) * cells.x;
  return mix(mix(p.gains.v[above + a.x], p.gains.v[above + b.x], w.x),
             mix(p.gains.v[below + a.x], p.gains.v[below + b.x], w.x), w.y);
}
float image_at(uint c, uint x, uint y) {
  const uint at = (c * p.rows + y) * p.stride + x;
  return p.rgb.v[at] * gain_at(c, x, y) * mask_at(x, y);
}
float target_at(uint c, uint x, uint y) {
  const uint at = target_pixel(x, y);
  float value = float(byte_of(p.target, at * 3u + c)) / 255.0;
  if (p.has_alpha != 0u)
    value += (1.0 - float(byte_of(p.alpha, at)) / 255.0) * p.background_change[c];
  return value * mask_at(x, y);
}
#if PASS == 0
// Sums the values over each patch of 8 x 8 pixels, to s_patch [kValues, 4].
void sum_patches() {
  const uint t = gl_LocalInvocationIndex;
  sync();
  float sum = 0.0;
  for (uint j = 0u; j < 8u; ++j)
    sum += s_value[R(5u, (t / 32u) * 256u + (t % 32u) * 8u + j)];
  s_part[W(6u, t)] = sum;
  sync();
  if (t < 32u) {
    sum = 0.0;
    for (uint j = 0u; j < 8u; ++j) sum += s_part[R(6u, t * 8u + j)];
    s_patch[W(6u, 300u + t) - 300u] = sum;
  }
  sync();
}
float sum_of(uint value) {
  float sum = 0.0;
  for (uint j = 0u; j < 4u; ++j) sum += s_patch[R(6u, 300u + value * 4u + j) - 300u];
  return sum;
}
#endif
void main() {
  const uint tile = group_index(), t = gl_LocalInvocationIndex, lx = t & 15u, ly = t >> 4;
  if (tile * 256u >= p.stride * p.rows) return;
  const ivec2 corner = ivec2(tile % p.tiles_x, tile / p.tiles_x) * 16;
  const uint x = uint(corner.x) + lx, y = uint(corner.y) + ly;
  const uint plane = p.stride * p.rows, at = y * p.stride + x;
  const bool inside = x < p.width && y < p.height;
  const float mask = inside ? mask_at(x, y) : 0.0;
#if PASS == 0
  float total = 0.0;
  // Places of pixels are by patch, then row by row.
  const uint place = ((ly >> 3) * 2u + (lx >> 3)) * 64u + (ly & 7u) * 8u + (lx & 7u);
#else
  float absolute = 0.0;
  const float each = mask / max(p.sums.v[3], 1.0), of_channel = each / 3.0;
#endif
  for (uint c = 0u; c < 3u; ++c) {
    for (uint i = t; i < kSide * kSide; i += 256u) {
      const ivec2 q = corner + ivec2(i % kSide, i / kSide) - int(kHalo);
      const bool in_q = q.x >= 0 && q.y >= 0 && q.x < int(p.width) && q.y < int(p.height);
#if PASS == 0
      s_x[W(0u, i)] = in_q ? image_at(c, uint(q.x), uint(q.y)) : 0.0;
      s_y[W(1u, i)] = in_q ? target_at(c, uint(q.x), uint(q.y)) : 0.0;
#else
      const uint at_q = in_q ? 3u * c * plane + uint(q.y) * p.stride + uint(q.x) : 0u;
      s_x[W(0u, i)] = in_q ? p.slopes.v[at_q] : 0.0;
      s_y[W(1u, i)] = in_q ? p.slopes.v[at_q + plane] : 0.0;
      s_z[W(2u, i)] = in_q ? p.slopes.v[at_q + 2u * plane] : 0.0;
#endif
    }
    sync();
    for (uint i = t; i < kColumns; i += 256u) {
      const uint from = i / 16u * kSide + i % 16u;
      float m[kMoments];
      for (uint j = 0u; j < kMoments; ++j) m[j] = 0.0;
      for (uint k = 0u; k < uint(kSsimTaps); ++k) {
        const float u = s_x[R(0u, from + k)], v = s_y[R(1u, from + k)];
        const float tu = kSsimWeights[k] * u, tv = kSsimWeights[k] * v;
        m[0] += tu;
        m[1] += tv;
#if PASS == 0
        m[2] += tu * u;
        m[3] += tv * v;
        m[4] += tu * v;
#else
        m[2] += kSsimWeights[k] * s_z[R(2u, from + k)];
#endif
      }
      for (uint j = 0u; j < kMoments; ++j)
        s_m[W(3u, j * kColumns + i)] = m[j];
    }
    sync();
    float m[kMoments];
    for (uint j = 0u; j < kMoments; ++j) m[j] = 0.0;
    for (uint k = 0u; k < uint(kSsimTaps); ++k)
      for (uint j = 0u; j < kMoments; ++j)
        m[j] += kSsimWeights[k] * s_m[R(3u, j * kColumns + (ly + k) * 16u + lx)];
#if PASS == 0
    float ssim, by_x, by_xx, by_xy;
    ssim_gradient(m, ssim, by_x, by_xx, by_xy);
    const float scale = -0.5 * p.ssim_weight * mask;
    p.slopes.v[3u * c * plane + at] = by_x * scale;
    p.slopes.v[(3u * c + 1u) * plane + at] = by_xx * scale;
    p.slopes.v[(3u * c + 2u) * plane + at] = by_xy * scale;
    const uint here = (ly + kHalo) * kSide + lx + kHalo;
    const float u = s_x[R(0u, here)], v = s_y[R(1u, here)], off = u - v;
    const float counts = v < kSaturated ? mask : 0.0;
    s_value[W(5u, place)] = counts;
    s_value[W(5u, 256u + place)] = counts * v;
    s_value[W(5u, 512u + place)] = counts * u;
    s_value[W(5u, 768u + place)] = v;
    s_value[W(5u, 1024u + place)] = v * v;
    s_value[W(5u, 1280u + place)] = abs(off);
    s_value[W(5u, 1536u + place)] = off * off;
    s_value[W(5u, 1792u + place)] = mask * (1.0 - ssim);
    sum_patches();
    if (t < 12u) {  // value t / 4 of patch t % 4
      const uint patch_at = (tile / p.tiles_x * 2u + (t % 4u) / 2u) * (p.stride / 8u) +
                         tile % p.tiles_x * 2u + t % 2u;
      p.patches.v[9u * patch_at + t / 4u * 3u + c] = s_patch[R(6u, 300u + t) - 300u];
    } else if (t < 14u) {
      p.tile_sums.v[16u * tile + 4u + (t - 12u) * 3u + c] = sum_of(t - 9u);
    } else if (t < 17u) {
      total += sum_of(t - 9u);
    }
#else
    float d = 0.0;
    if (inside) {
      const float u = image_at(c, x, y), v = target_at(c, x, y), off = u - v;
      d = (float(off > 0.0) - float(off < 0.0)) * p.l1_weight +
          (m[0] + 2.0 * u * m[1] + v * m[2]);
      d *= of_channel * gain_at(c, x, y);
      absolute += abs(off);
    }
    p.d_rgb.v[c * plane + at] = d;
#endif
  }
#if PASS == 0
  if (t >= 14u && t < 17u) p.tile_sums.v[16u * tile + t - 14u] = total;  // |off|, off^2, 1 - SSIM
  for (uint k = 3u; k < kValues; ++k) s_value[W(5u, k * 256u + place)] = 0.0;
  s_value[W(5u, place)] = mask;
  s_value[W(5u, 256u + place)] = p.has_pixels != 0u && inside ? mask * p.transmittance.v[at] : 0.0;
  const bool ranged = p.has_ranges != 0u && inside && p.log_range.v[at] != kNoRange;
  s_value[W(5u, 512u + place)] = ranged ? p.range_error.v[at] : 0.0;
  sum_patches();
  if (t == 0u) p.tile_sums.v[16u * tile + 3u] = sum_of(0u);
  if (t == 1u || t == 2u) p.tile_sums.v[16u * tile + 9u + t] = sum_of(t);
#else
  p.error.v[at] = absolute / 3.0;
  if (p.has_pixels == 0u) return;
  p.d_transmittance.v[at] = each * p.transmittance_weight;
  if (p.has_ranges != 0u)
    p.d_range.v[at] = inside && p.log_range.v[at] != kNoRange ? p.range_each : 0.0;
#endif
}
