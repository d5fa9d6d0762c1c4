// SPDX-License-Identifier: Apache-2.0
// What the beams of a LiDAR, which moves while it turns, see of Gaussians: range, intensity and the
// probability that nothing comes back. Beams are rasterised as images are (ray_raster.h). Ring and
// firing order need not be known.
#pragma once

#include <functional>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/rays.h"
#include "redrive/methods/splat/actors/drawn_gaussians.h"
#include "redrive/methods/splat/lidar/ray_raster.h"
#include "redrive/model/rendered_image.h"

namespace redrive {

/// `drawn`: returns what rays of a raster see, whose parts have one pose for each of key_poses().
RenderedRays trace_gaussians(kernels::GaussianStages& stages, ThreadPool& pool,
                             const kernels::Rays& rays,
                             const std::function<DrawnGaussians(const RayRaster&)>& drawn,
                             double beam_rad = kBeam_rad);

}  // namespace redrive
