// SPDX-License-Identifier: Apache-2.0
// The surface of a volume as triangles, by OpenVDB's dual marching cubes.
#pragma once

#include <optional>
#include <string>

#include "redrive/export/mesh/triangle_mesh.h"
#include "redrive/export/mesh/tsdf_volume.h"

namespace redrive {

/// Returns why this program makes no meshes, naming what was missing when it was built; nothing
/// where it can.
std::optional<std::string> mesh_obstacle();

/// Returns the surface where the distance is 0, within cells whose eight sample points are known,
/// with trilinear colours, facing the side of positive distance. Pieces of fewer than
/// `least_triangles` are left out. There must be no mesh_obstacle().
TriangleMesh surface_mesh(const TsdfVolume& volume, std::size_t least_triangles, ThreadPool& pool);

}  // namespace redrive
