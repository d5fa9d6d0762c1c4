// SPDX-License-Identifier: Apache-2.0
// 3D Gaussians as the PLY file of 3D Gaussian Splatting (Kerbl et al. 2023, the authors' code),
// which viewers read.
#pragma once

#include <span>
#include <string>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Returns a file in binary_little_endian with the float properties, in this order:
///   x y z          mean, world metres
///   nx ny nz       0
///   f_dc_0..2      (colour - 0.5) / C0 of r, g, b
///   f_rest_0..8    with sh_degree 1 only: r's three coefficients of degree 1, then g's, then b's
///   opacity        logit
///   scale_0..2     logarithms of the standard deviations, metres
///   rot_0..3       unit quaternion w x y z
/// Coefficients refer to the basis of field/spherical_harmonics.h, C0 its constant, over the unit
/// direction from the camera to the mean in the world. sh_degree: 0 or 1; 0 omits the change of
/// colour by direction. `comments`: lines of the header.
std::string gaussian_ply(const kernels::Gaussians& gaussians, int sh_degree,
                         std::span<const std::string> comments = {});

}  // namespace redrive
