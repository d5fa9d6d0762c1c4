// SPDX-License-Identifier: Apache-2.0
// The ground's part of a mesh, for the wheels of a simulated car.
#pragma once

#include <cstddef>
#include <span>

#include "redrive/export/mesh/triangle_mesh.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// The ground is searched within this distance of the driven line.
constexpr double kGroundReach_m = 15;

/// Returns the triangles within kGroundReach_m of a pose of the body that face its z axis within 37
/// degrees and lie at most 0.3 m plus a twentieth of the distance above or below its x-y plane:
/// road, kerbs and pavements, but no cars. `driven`: poses of the body, whose origin is on the
/// ground.
TriangleMesh ground_of_mesh(const TriangleMesh& mesh, std::span<const Rigid3d> driven);

/// Half the width of the strip that wheels touched, and how far it goes on at its ends.
constexpr double kUnderBody_m = 1.5, kBeyondEnds_m = 2;

/// Adds squares where the ground has no triangle under the driven line: behind the first pose,
/// which no camera saw, and in holes. They lie on the x-y planes of the poses, on which the wheels
/// stood, shifted as the ground beside them is. Grey. Returns the number of triangles added.
std::size_t fill_under_body(std::span<const Rigid3d> driven, TriangleMesh* ground);

}  // namespace redrive
