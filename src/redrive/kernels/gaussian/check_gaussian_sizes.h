// SPDX-License-Identifier: Apache-2.0
// Size checks of the stages of rasterising Gaussians.
#pragma once

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

inline void check_rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                            const RasterOptions& options) {
  const RasterSize size = raster_size(camera.camera.width, camera.camera.height);
  REDRIVE_CHECK(size.width > 0 && size.height > 0);
  REDRIVE_CHECK(!camera.world_from_camera.empty());
  const PixelCentres& centres = camera.centres;
  REDRIVE_CHECK(centres.u.size() == centres.v.size() &&
                (centres.u.empty() || centres.u.size() == size.plane()));
  REDRIVE_CHECK_OP(gaussians.numbers.size(), ==, gaussian_blocks(gaussians.n) * kBlockSize);
  std::size_t last_block = 0;
  for (const GaussianPart& part : camera.parts) {
    REDRIVE_CHECK(part.part_from_camera.empty() ||
                  part.part_from_camera.size() == camera.world_from_camera.size());
    REDRIVE_CHECK(last_block <= part.first_block &&
                  part.first_block <= gaussian_blocks(gaussians.n));
    last_block = part.first_block;
  }
  REDRIVE_CHECK_OP(camera.parts.size(), <=, std::size_t{65535});
  REDRIVE_CHECK(options.tiles.empty() ||
                options.tiles.size() == size.plane() / (kTileSide * kTileSide));
  REDRIVE_CHECK(options.log_range.empty() || options.log_range.size() == size.plane());
  REDRIVE_CHECK(options.ranged.size() <= options.log_range.size());
}

/// `camera`, `gaussians` and `options`: the forward pass's.
inline void check_rasterise_backward(const GaussianCamera& camera, const Gaussians& gaussians,
                                     const RasterOptions& options, const RasterGradient& gradient,
                                     const GaussianDerivatives& to, std::size_t d_poses) {
  const std::size_t plane = raster_size(camera.camera.width, camera.camera.height).plane();
  REDRIVE_CHECK_OP(gradient.d_rgb.size(), ==, 3 * plane);
  REDRIVE_CHECK_OP(gradient.d_transmittance.size(), ==, plane);
  REDRIVE_CHECK_OP(gradient.error.size(), ==, plane);
  REDRIVE_CHECK_OP(gradient.d_range.size(), ==, options.log_range.empty() ? 0 : plane);
  const std::size_t numbers = gaussians.numbers.size(), errors = numbers / kGaussianRows;
  REDRIVE_CHECK_OP(to.errors.size(), ==, to.update ? 0 : errors);
  REDRIVE_CHECK(to.gradients.empty() || (!to.update && to.gradients.size() == numbers));
  if (to.update) {
    REDRIVE_CHECK(to.update->rows == seen_by(camera.camera));
    REDRIVE_CHECK(to.update->numbers.size() == numbers && to.update->moments.size() == numbers &&
                  to.update->errors.size() == errors);
  }
  REDRIVE_CHECK(d_poses == 0 || d_poses == 1 + camera.parts.size());
}

inline void check_image_loss(const ImageLossInput& input, std::size_t d_rgb, std::size_t error) {
  const std::size_t plane = input.size.plane();
  REDRIVE_CHECK_OP(input.rgb.size(), ==, 3 * plane);
  const PixelGains& gains = input.gains;
  REDRIVE_CHECK(gains.log_shading.empty() || (gains.columns > 0 && gains.rows > 0));
  REDRIVE_CHECK_OP(gains.log_shading.size(), ==,
                   3 * static_cast<std::size_t>(gains.columns) * gains.rows);
  const TargetWindow& target = input.target;
  const std::size_t pixels = target.rgb.size() / 3;
  REDRIVE_CHECK(target.x >= 0 && target.y >= 0 && target.x + input.size.width <= target.width);
  REDRIVE_CHECK(static_cast<std::size_t>(target.y + input.size.height) * target.width <= pixels);
  REDRIVE_CHECK(target.alpha.empty() || target.alpha.size() == pixels);
  REDRIVE_CHECK(target.used.empty() || target.used.size() == pixels);
  REDRIVE_CHECK_OP(d_rgb, ==, 3 * plane);
  REDRIVE_CHECK_OP(error, ==, plane);
}

inline void check_update_gaussians(const GaussianUpdate& update, std::size_t n,
                                   std::size_t gradients, std::size_t errors) {
  const std::size_t size = gaussian_blocks(n) * kBlockSize;
  REDRIVE_CHECK(gradients == size && update.numbers.size() == size &&
                update.moments.size() == size);
  REDRIVE_CHECK(errors == size / kGaussianRows && update.errors.size() == errors);
}

}  // namespace redrive::kernels
