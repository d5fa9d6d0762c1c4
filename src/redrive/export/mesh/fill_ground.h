// SPDX-License-Identifier: Apache-2.0
// Closes holes in the ground that a car drove over.
#pragma once

#include <span>

#include "redrive/export/mesh/tsdf_volume.h"

namespace redrive {

/// Gaps of the ground up to kGroundGap_m wide are filled; the ground is searched within
/// kGroundCorridor_m of the driven line.
constexpr double kGroundGap_m = 3, kGroundCorridor_m = 5;

/// Fills gaps of the ground in a world of metres whose z axis points up. `driven`: positions of the
/// body, in order. In each column of points near the driven line the ground is the surface that
/// lies, to 0.5 m, as far below the body as most of the line's ground does. Columns without ground
/// that its closing by a square of kGroundGap_m covers get the height and the colour that continue
/// those around them (a discrete Laplace equation). There and on the ground found, unknown points
/// within the truncation get the vertical distance; known ones stay, but in filled columns get
/// the smaller of both distances. Returns the number of columns that were filled. UsageError as
/// TsdfVolume::add.
std::size_t fill_ground(std::span<const Eigen::Vector3d> driven, TsdfVolume* volume);

}  // namespace redrive
