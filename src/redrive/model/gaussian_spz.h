// SPDX-License-Identifier: Apache-2.0
// 3D Gaussians as an SPZ file, version 3 (Niantic, github.com/nianticlabs/spz), which viewers read.
#pragma once

#include <string>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Returns the numbers of field/splat_numbers.h, rounded, all of one kind after the other,
/// compressed by gzip:
///   header (16 bytes): "NGSP", version 3, n (32 bits each), sh_degree, fractional bits of
///                  positions, 1: antialiased, 0 (8 bits each)
///   position       24 bits signed, with as many fractional bits as the largest one leaves, 12 at
///                  most: 0.2 mm within 2 km; farther ones are put onto the edge of 8388 km
///   opacity        255 sigmoid
///   colour         255 (0.15 dc + 0.5)
///   log_scale      16 (log_scale + 10)
///   quaternion     32 bits: the three smaller of x y z w with 10 bits each, which is largest with
///   2 rest           128 rest + 128, by coefficient, then channel; with sh_degree 1 only
/// sh_degree: 0 or 1.
std::string gaussian_spz(const kernels::Gaussians& gaussians, int sh_degree);

}  // namespace redrive
