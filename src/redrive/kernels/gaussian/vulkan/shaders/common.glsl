// SPDX-License-Identifier: Apache-2.0
// What the shaders share: buffers by address, the parameter block, tiles.
//
// Shared memory is indexed through R (read), W (write) and A (atomic), barriers are sync(): see
// races.glsl.
#extension GL_EXT_buffer_reference : require
#ifdef RACES
#define SHADOW layout(offset = 112) Words shadow;
#else
#define SHADOW
#endif
#include "constants.glsl"

// Groups are dispatched in rows of as many as the device allows; the last row may have some too
// many.
uint group_index() {
  return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}
// A macro, since the layout, which sets gl_WorkGroupSize, follows this file.
#define thread_index() (group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex)

layout(buffer_reference, std430, buffer_reference_align = 4) buffer Floats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Words { uint v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) buffer Vec4s { vec4 v[]; };

// ShaderParameters of vulkan_raster.cc has the same layout.
layout(buffer_reference, std430, buffer_reference_align = 16) buffer Params {
  // [n] in blocks of 16; of parts: quaternion w x y z of camera_from_world and centre by key; first
  // block of each part, and its object << 1 | whether it is drawn; object 0 is the world.
  Floats numbers, pose_keys;
  Words parts;
  // Drawn Gaussians: [n, 4] records, [n] key (bits of the distance; kNotDrawn), ids ascending and
  // by distance.
  Vec4s records;
  Words depth_key, drawn, by_depth;
  // Pairs of a Gaussian and a tile: [drawn] number, then first; by pair: Gaussian, blocks that it
  // meets; [tiles + 1] first pair of each tile.
  Words pair_first, pair_gaussian, pair_blocks, ranges;
  // [0] number drawn, [1] of pairs, [2] not 0: too many pairs, [3] not 0: the loss is not finite
  Words control;
  Words wanted;   // [tiles] 0: not wanted
  // Centres of pixels: planes; boxes [tiles, 4, 8] and extents (centre_boxes.h).
  Floats centre_u, centre_v, boxes, extents;
  // Planes of the image.
  Floats rgb, transmittance, depth, range_error, log_range;
  Words last;  // [pixels] number of a tile's pairs up to where the pixel ended
  Floats d_rgb, d_transmittance, error, d_range;
  // Sums over pixels by pair, then by Gaussian [n, 16]; derivatives [n] in blocks and errors.
  Floats pair_sums, sums, gradients, errors;
  // A tile's segments after the first one, by state_of: transmittance, colour and range error of
  // its pixels before the segment [kStateFloats, 256], and the tile.
  Floats states;
  Words segments;
  float fx, fy, cx, cy, numbers_of_lens[kLensNumbers], max_radius2;  // camera/plain_camera.h
  uint n, width, height, stride, rows, tiles_x, tiles_y;
  uint n_parts, n_keys, by_column, bounds_means, max_pairs;
  float first_line, row_scale, row_offset;
  float left, right, top, bottom;                  // of the pixels
  float mean_left, mean_right, mean_top, mean_bottom;  // of the means
  float background[3];
};

uint byte_of(Words w, uint i) {
  return w.v[i >> 2] >> (8u * (i & 3u)) & 255u;
}

const uint kNotDrawn = 0xffffffffu;
const uint kNumbers = uint(kGaussianRows), kSumsOfPair = 16u;

// A tile's pairs are blended backward in segments. state_of(begin, k) is the index of segment k > 0
// of a tile whose pairs begin at `begin`. Indices of tiles differ and are below pairs / kSegment,
// since floor(begin / S) + ceil(n / S) - 1 <= floor((begin + n) / S).
const uint kSegment = 256u, kStateFloats = 5u;
uint state_of(uint begin, uint k) {
  return begin / kSegment + k - 1u;
}

uint slot_of(uint gaussian) {
  return gaussian / 16u * uint(kBlockSize) + gaussian % 16u;
}

// Returns the last part that begins before the Gaussian's block.
uint part_of(Params p, uint gaussian) {
  uint part = 0u;
  for (uint step = 1u << 15; step > 0u; step >>= 1)
    if (part + step < p.n_parts && p.parts.v[2u * (part + step)] <= gaussian / 16u) part += step;
  return part;
}

// A tile's 256 pixels are 8 blocks of 8 x 4; lane t has pixel t % 32 of block t / 32.
uvec2 pixel_in_tile(uint t) {
  return uvec2((t & 7u) | ((t >> 5) & 1u) << 3, ((t >> 3) & 3u) | (t >> 6) << 2);
}
