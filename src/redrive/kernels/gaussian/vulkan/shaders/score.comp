// SPDX-License-Identifier: Apache-2.0
// Backend::score in tiles of 16 x 16 pixels. PASS 0: planes of both images, squared errors; 1:
// SSIM; 2: FLIP.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "flip.glsl"
#include "ssim.glsl"
layout(local_size_x = 256) in;
// VulkanScore::Parameters has the same layout.
layout(buffer_reference, std430, buffer_reference_align = 16) buffer Score {
  Floats rgb;          // [height, width, 3]
  Words target, mask;  // bytes [height, width, 3], [height, width]
  Floats planes;       // [2, 6, height, width]: sRGB, black where masked, opponent colours
  Floats sums;         // [tiles, 8] by ScoreSum
  uint width, height, tiles_x, has_mask;
  float levels[256];  // a byte / 255, which a device may round otherwise
};
layout(push_constant) uniform Push {
  Score p;
  SHADOW
};
#include "races.glsl"
shared float s_sum[256];

float mask_at(uint x, uint y) {
  return p.has_mask != 0u ? float(min(byte_of(p.mask, y * p.width + x), 1u)) : 1.0;
}
// Adds up the threads' values, to sum `k` of the tile.
void add(uint tile, uint k, float value) {
  const uint t = gl_LocalInvocationIndex;
  s_sum[W(0u, t)] = value;
  for (uint d = 128u; d > 0u; d >>= 1) {
    sync();
    if (t < d) s_sum[W(0u, t)] += s_sum[R(0u, t + d)];
  }
  if (t == 0u) p.sums.v[8u * tile + k] = s_sum[R(0u, 0u)];
  sync();
}
#if PASS > 0
// Pixels of planes around the tile, and what a filter along their columns makes of them.
#if PASS == 1
const uint kHalo = uint(kSsimRadius), kPlanes = 2u, kMoments = 5u;
#else
const uint kHalo = uint(kFlipColourRadius), kPlanes = 1u, kMoments = 1u;
#endif
const uint kSide = 16u + 2u * kHalo, kColumns = 16u * kSide;
shared float s_in[kPlanes * kSide * kSide], s_columns[kMoments * kColumns];
// The border's pixels go on beyond it.
void load_plane(uint to, uint image, uint plane, uvec2 corner) {
  for (uint i = gl_LocalInvocationIndex; i < kSide * kSide; i += 256u) {
    const ivec2 at = ivec2(corner) + ivec2(i % kSide, i / kSide) - int(kHalo);
    const uvec2 pixel = uvec2(clamp(at, ivec2(0), ivec2(p.width, p.height) - 1));
    s_in[W(1u, to * kSide * kSide + i)] =
        p.planes.v[((6u * image + plane) * p.height + pixel.y) * p.width + pixel.x];
  }
}
#endif
#if PASS == 2
// Macros, since a function would copy the taps.
#define FILTER_COLUMNS(taps)                                                                \
  sync();                                                                                   \
  for (uint i = t; i < kColumns; i += 256u) {                                               \
    const uint first = i / kSide + kHalo - uint(taps.length()) / 2u;                        \
    float sum = 0.0;                                                                        \
    for (uint j = 0u; j < uint(taps.length()); ++j)                                         \
      sum += taps[j] * s_in[R(1u, (first + j) * kSide + i % kSide)];                        \
    s_columns[W(2u, i)] = sum;                                                              \
  }                                                                                         \
  sync();
#define ADD_ROW(taps, weight, sum)                                                          \
  for (uint j = 0u; j < uint(taps.length()); ++j)                                           \
    sum += weight * taps[j] *                                                               \
           s_columns[R(2u, ly * kSide + lx + kHalo - uint(taps.length()) / 2u + j)];
#endif

void main() {
  const uint tile = group_index(), t = gl_LocalInvocationIndex, lx = t & 15u, ly = t >> 4;
  if (tile >= p.tiles_x * ((p.height + 15u) / 16u)) return;
  const uvec2 corner = uvec2(tile % p.tiles_x, tile / p.tiles_x) * 16u;
  const uint x = corner.x + lx, y = corner.y + ly;
  const bool inside = x < p.width && y < p.height, used = inside && mask_at(x, y) > 0.0;
#if PASS == 0
  float squares[3] = float[](0.0, 0.0, 0.0), luma = 0.0;
  if (inside) {
    const uint at = y * p.width + x, plane = p.width * p.height;
    float srgb[2][3];
    for (uint c = 0u; c < 3u; ++c) {
      srgb[0][c] = used ? p.rgb.v[3u * at + c] : 0.0;
      srgb[1][c] = used ? p.levels[byte_of(p.target, 3u * at + c)] : 0.0;
      const float off = srgb[0][c] - srgb[1][c];
      squares[c] = off * off;
      luma += off / 3.0;
    }
    for (uint image = 0u; image < 2u; ++image) {
      float opponent[3];
      flip_opponent(srgb[image], opponent);
      for (uint c = 0u; c < 3u; ++c) {
        p.planes.v[(6u * image + c) * plane + at] = srgb[image][c];
        p.planes.v[(6u * image + 3u + c) * plane + at] = opponent[c];
      }
    }
  }
  add(tile, 0u, luma * luma);
  for (uint c = 0u; c < 3u; ++c) add(tile, 1u + c, squares[c]);
  add(tile, 4u, used ? 1.0 : 0.0);
#elif PASS == 1
  const bool window =
      used && x >= kHalo && y >= kHalo && x + kHalo < p.width && y + kHalo < p.height;
  float total = 0.0;
  for (uint c = 0u; c < 3u; ++c) {
    for (uint image = 0u; image < 2u; ++image) load_plane(image, image, c, corner);
    sync();
    for (uint i = t; i < kColumns; i += 256u) {
      float m[5] = float[](0.0, 0.0, 0.0, 0.0, 0.0);
      for (uint k = 0u; k < uint(kSsimTaps); ++k) {
        const uint from = (i / kSide + k) * kSide + i % kSide;
        const float u = s_in[R(1u, from)], v = s_in[R(1u, kSide * kSide + from)];
        const float tu = kSsimWeights[k] * u, tv = kSsimWeights[k] * v;
        m[0] += tu;
        m[1] += tv;
        m[2] += tu * u;
        m[3] += tv * v;
        m[4] += tu * v;
      }
      for (uint j = 0u; j < kMoments; ++j) s_columns[W(2u, j * kColumns + i)] = m[j];
    }
    sync();
    float m[5] = float[](0.0, 0.0, 0.0, 0.0, 0.0);
    for (uint k = 0u; k < uint(kSsimTaps); ++k)
      for (uint j = 0u; j < kMoments; ++j)
        m[j] += kSsimWeights[k] * s_columns[R(2u, j * kColumns + ly * kSide + lx + k)];
    float ssim, by_x, by_xx, by_xy;
    ssim_gradient(m, ssim, by_x, by_xx, by_xy);
    if (window) total += ssim;
  }
  add(tile, 5u, total);
  add(tile, 6u, window ? 1.0 : 0.0);
#else
  float pixels[2][5];
  for (uint image = 0u; image < 2u; ++image) {
    float opponent[3] = float[](0.0, 0.0, 0.0);
    vec2 edges = vec2(0), points = vec2(0);
    load_plane(0u, image, 3u, corner);
    FILTER_COLUMNS(kFlipColour0)
    ADD_ROW(kFlipColour0, kFlipWeights[0], opponent[0])
    FILTER_COLUMNS(kFlipSmooth)
    ADD_ROW(kFlipFirst, 1.0, edges.x)
    ADD_ROW(kFlipSecond, 1.0, points.x)
    FILTER_COLUMNS(kFlipFirst)
    ADD_ROW(kFlipSmooth, 1.0, edges.y)
    FILTER_COLUMNS(kFlipSecond)
    ADD_ROW(kFlipSmooth, 1.0, points.y)
    load_plane(0u, image, 4u, corner);
    FILTER_COLUMNS(kFlipColour1)
    ADD_ROW(kFlipColour1, kFlipWeights[1], opponent[1])
    load_plane(0u, image, 5u, corner);
    FILTER_COLUMNS(kFlipColour2)
    ADD_ROW(kFlipColour2, kFlipWeights[2], opponent[2])
    FILTER_COLUMNS(kFlipColour3)
    ADD_ROW(kFlipColour3, kFlipWeights[3], opponent[2])
    float lab[3];
    flip_lab(opponent, lab);
    for (uint k = 0u; k < 3u; ++k) pixels[image][k] = lab[k];
    pixels[image][3] = length(edges);
    pixels[image][4] = length(points);
  }
  float error;
  flip_difference(pixels[0], pixels[1], error);
  add(tile, 7u, used ? error : 0.0);
#endif
}
