// SPDX-License-Identifier: Apache-2.0
// 3D Gaussians as binary glTF 2.0 with KHR_gaussian_splatting (Khronos, ratified).
#pragma once

#include <string>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Returns a GLB with one primitive of points and the attributes, floats all of them,
///   POSITION               metres; the node turns x, y, z to glTF's z, x, y, of which y is up
///   KHR_gaussian_splatting:ROTATION   unit quaternion x y z w
///   KHR_gaussian_splatting:SCALE      standard deviations, metres
///   KHR_gaussian_splatting:OPACITY    0..1
///   KHR_gaussian_splatting:SH_DEGREE_l_COEF_n   as f_dc and f_rest of model/gaussian_ply.h, r g b
/// sh_degree: 0 or 1. UsageError naming --to where 4 GiB, the format's limit, are not enough.
std::string gaussian_gltf(const kernels::Gaussians& gaussians, int sh_degree);

}  // namespace redrive
