// SPDX-License-Identifier: Apache-2.0
// Pictures of a model from any camera at any pose, tile by tile through the same kernels as
// training.
#pragma once

#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "redrive/model/model.h"
#include "redrive/rays/ray_table.h"

namespace redrive {

/// Pixels that the camera model does not reach are black with depth 0, opacity 0 and valid 0.
struct RenderedImage {
  int width = 0, height = 0;
  std::vector<float> rgb;  ///< [height, width, 3] in [0, 1]
  std::vector<float>
      depth;  ///< [height, width] metres along the ray, sum of w t (the ray's length, not z)
  std::vector<float> opacity;       ///< [height, width]
  std::vector<std::uint8_t> valid;  ///< [height, width]
};

/// A picture is made so many rays at a time, at most.
int max_tile_rays(const Model& model);

/// As the camera of the run shows it that `exposure` names.
RenderedImage render_image(kernels::Backend& backend, const Model& model, const Camera& camera,
                           const ShutterPoses& world_from_camera, const Exposure& exposure = {});
RenderedImage render_image(kernels::Backend& backend, const Model& model, const RayTable& table,
                           const ShutterPoses& world_from_camera, const Exposure& exposure = {});

Image8 to_image8(const RenderedImage& image);                     ///< round(255 x), clamped
std::vector<std::uint16_t> depth_mm(const RenderedImage& image);  ///< 65535: 65.535 m and more

}  // namespace redrive
