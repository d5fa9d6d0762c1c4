// SPDX-License-Identifier: Apache-2.0
// 3D Gaussians as OpenUSD text with a ParticleField3DGaussianSplat (OpenUSD 26.03).
#pragma once

#include <string>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Returns the layer of a USDZ: z up, metres, the prim /World/Gaussians with
///   point3f[] positions     metres, to 0.1 mm
///   quatf[] orientations    unit quaternion w x y z
///   float3[] scales         standard deviations, metres
///   float[] opacities       0..1
///   float3[] radiance:sphericalHarmonicsCoefficients   (sh_degree + 1)^2 of each Gaussian: f_dc,
///                           then f_rest of model/gaussian_ply.h, r g b
/// and extent, three standard deviations around the means. Numbers have the digits of halves, but
/// the attributes are the floats that every reader knows. sh_degree: 0 or 1.
std::string gaussian_usd(const kernels::Gaussians& gaussians, int sh_degree);

}  // namespace redrive
