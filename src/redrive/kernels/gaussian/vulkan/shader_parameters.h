// SPDX-License-Identifier: Apache-2.0
// What the shaders of a raster read: addresses of its buffers, and its camera.
#pragma once

#include <cstdint>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels::vulkan {

/// Params of shaders/common.glsl.
struct ShaderParameters {
  VkDeviceAddress numbers, pose_keys, parts, records, depth_key, drawn, by_depth, pair_first,
      pair_gaussian, pair_blocks, ranges, control, wanted, centre_u, centre_v, boxes, extents, rgb,
      transmittance, depth, range_error, log_range, last, d_rgb, d_transmittance, error, d_range,
      pair_sums, sums, gradients, errors, states, segments;
  float fx, fy, cx, cy, numbers_of_lens[PlainCamera::kMostNumbers], max_radius2;
  std::uint32_t n, width, height, stride, rows, tiles_x, tiles_y, n_parts, n_keys, by_column,
      bounds_means, max_pairs;
  float first_line, row_scale, row_offset;
  RasterBounds pixels, means;
  float background[3];
};

/// Sets what follows from the camera and the size of its image.
void set_camera(const GaussianCamera& from, const RasterSize& size, ShaderParameters* p);

}  // namespace redrive::kernels::vulkan
