// SPDX-License-Identifier: Apache-2.0
// Renders images of a model from any camera at any pose, by the same kernels as training.
#pragma once

#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "redrive/model/field.h"
#include "redrive/rays/ray_table.h"

namespace redrive {

/// Uses the exposure gains of the run's camera that `exposure` names.
RenderedImage render_image(kernels::Backend& backend, const Field& model, const Camera& camera,
                           const ShutterPoses& world_from_camera, const Exposure& exposure = {});
RenderedImage render_image(kernels::Backend& backend, const Field& model, const RayTable& table,
                           const ShutterPoses& world_from_camera, const Exposure& exposure = {});

Image8 to_image8(const RenderedImage& image);                     ///< round(255 x), clamped
Image8 opacity_image(const RenderedImage& image);                 ///< grey, likewise
std::vector<std::uint16_t> depth_mm(const RenderedImage& image);  ///< 65535: 65.535 m and more

}  // namespace redrive
