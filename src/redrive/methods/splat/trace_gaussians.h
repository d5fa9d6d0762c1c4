// SPDX-License-Identifier: Apache-2.0
// Depth of Gaussians along single rays of any origin, such as a LiDAR's beams.
//
// Gaussians are rasterised, not traced (field/gaussian.h). So rays are grouped by their origins,
// the depth that a group's rays cross is drawn on the faces of a cube around their mean origin, in
// the tiles that the rays cross, and each ray is intersected with the drawn surface from its own
// origin.
#pragma once

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/rays.h"
#include "redrive/model/rendered_image.h"

namespace redrive {

/// Returns depth and opacity of each ray. Planes are exact from about 2 m on, up to the Gaussians
/// that they consist of: between pixels the inverse of the depth along the face's axis is
/// interpolated. At the edge of a surface the nearest pixel counts.
RenderedRays trace_gaussians(kernels::GaussianStages& stages, const kernels::Gaussians& gaussians,
                             const kernels::Rays& rays);

}  // namespace redrive
