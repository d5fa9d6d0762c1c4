// SPDX-License-Identifier: Apache-2.0
// Coloured triangles and their files.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "redrive/recording/lidar/ply.h"

namespace redrive {

struct TriangleMesh {
  std::vector<PlyPoint> vertices;
  std::vector<Triangle> triangles;  ///< counterclockwise, seen from the side of the normal
};

/// Removes pieces of fewer than `least` triangles that share vertices, and vertices without a
/// triangle.
void remove_small_pieces(std::size_t least, TriangleMesh* mesh);

/// Sets normals of vertices: the mean of their triangles' normals, weighted by area.
void compute_normals(TriangleMesh* mesh);

/// Returns the mesh as a Wavefront OBJ: lines `v x y z r g b`, colours in [0, 1], and `f`.
std::string make_obj(const TriangleMesh& mesh);

/// Returns the mesh as glTF 2.0, binary: POSITION, COLOR_0 (linear, 16 bits) and an unlit material
/// (KHR_materials_unlit), since light is in the colours. glTF's y axis points up: its x, y, z are
/// the mesh's y, z, x. Throws UsageError naming --voxel where 4 GiB, the format's limit, are not
/// enough.
std::string make_glb(const TriangleMesh& mesh);

}  // namespace redrive
