// SPDX-License-Identifier: Apache-2.0
// Depth of Gaussians along the beams of a LiDAR, which moves while it turns.
//
// Beams are rasterised as images are (kernels/gaussian/gaussian_stages.h), by the spherical
// projection (camera/spherical.h; Hess et al., SplatAD, CVPR 2025): every ray is a pixel with a
// centre of its own. A raster's origin moves evenly with the azimuth, as a spinning sensor's does
// for a quarter of a turn. Other rays, such as a second sensor's, take rasters of their own. Ring
// and firing order need not be known.
#pragma once

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/rays.h"
#include "redrive/model/rendered_image.h"

namespace redrive {

/// Full width of a beam, rad: data sheets of common sensors have 2 to 3 mrad.
constexpr double kBeam_rad = 3e-3;

/// Returns depth and opacity of each ray. beam_rad: > 0, full width of the rays; a Gaussian that is
/// narrower covers a part of them.
RenderedRays trace_gaussians(kernels::GaussianStages& stages, ThreadPool& pool,
                             const kernels::Gaussians& gaussians, const kernels::Rays& rays,
                             double beam_rad = kBeam_rad);

}  // namespace redrive
