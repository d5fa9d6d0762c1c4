// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/shader_parameters.h"

#include <algorithm>

#include "redrive/kernels/gaussian/mean_bounds.h"
#include "redrive/kernels/gaussian/shutter_keys.h"

namespace redrive::kernels::vulkan {

void set_camera(const GaussianCamera& from, const RasterSize& size, ShaderParameters* p) {
  const PlainCamera& camera = from.camera;
  const RasterBounds bounds = raster_bounds(from);
  const std::size_t n_keys = from.world_from_camera.size();
  p->fx = camera.fx;
  p->fy = camera.fy;
  p->cx = camera.cx;
  p->cy = camera.cy;
  std::ranges::copy(camera.numbers, p->numbers_of_lens);
  p->max_radius2 = camera.max_radius2;
  p->width = static_cast<std::uint32_t>(size.width);
  p->height = static_cast<std::uint32_t>(size.height);
  p->stride = static_cast<std::uint32_t>(size.stride);
  p->rows = static_cast<std::uint32_t>(size.rows);
  p->tiles_x = static_cast<std::uint32_t>(size.stride / kTileSide);
  p->tiles_y = static_cast<std::uint32_t>(size.rows / kTileSide);
  p->n_keys = static_cast<std::uint32_t>(n_keys);
  p->by_column = from.by_column;
  p->bounds_means = !from.centres.u.empty();
  p->first_line = first_line(from);
  p->row_scale = static_cast<float>(n_keys - 1) / from.image_rows;
  p->row_offset = (from.first_row + 0.5f) * p->row_scale;
  p->pixels = bounds;
  p->means = mean_bounds(from, bounds);
}

}  // namespace redrive::kernels::vulkan
