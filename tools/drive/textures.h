// SPDX-License-Identifier: Apache-2.0
// Colours of surfaces, with detail from metres to centimetres.
#pragma once

#include "tools/drive/caster.h"
#include "tools/drive/road.h"

namespace redrive::drive {

/// Linear RGB, 0..1, of the primitive's surface around a hit at `point` in the world.
/// `footprint_m`: edge of the part of the surface that is averaged.
Eigen::Vector3f albedo(const Road& road, const Primitive& primitive, const Hit& hit,
                       const Eigen::Vector3d& point, double footprint_m);

/// Fields around the street.
Eigen::Vector3f field_albedo(const Eigen::Vector3d& point, double footprint_m);

/// Linear RGB of the sky in a unit direction, clouds included. `footprint_rad`: as above.
Eigen::Vector3f sky_radiance(const Eigen::Vector3d& direction, double footprint_rad);

}  // namespace redrive::drive
