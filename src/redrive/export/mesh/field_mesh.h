// SPDX-License-Identifier: Apache-2.0
// The mesh of a trained field's surfaces.
#pragma once

#include <cstdint>

#include "redrive/export/mesh/triangle_mesh.h"
#include "redrive/export/mesh/tsdf_volume.h"
#include "redrive/train/run.h"

namespace redrive {

inline constexpr double kMeshVoxel_m = 0.1;           ///< default side of a voxel
inline constexpr double kVoxelsPerMedianDepth = 100;  ///< likewise for photographs

struct MeshOptions {
  double voxel_m =
      0;  ///< 0: kMeshVoxel_m; for photographs the median depth / kVoxelsPerMedianDepth
  std::uint64_t most_bytes = 0;  ///< memory that images and volume may take
};

struct FieldMesh {
  TriangleMesh mesh;  ///< in the scene's world; empty if the field has no opaque surface
  int images = 0;     ///< images rendered
  double voxel_m = 0, range_m = 0;
  double filled_m2 = 0;  ///< area of the filled gaps of the ground (export/mesh/fill_ground.h)
};

/// Renders training views, evenly at most 200, and fuses their depth and colours up to 400 voxels
/// from the camera (export/mesh/tsdf_volume.h) into a mesh. Excludes masked pixels, moving objects,
/// and opacity below 0.9, which is sky. Fills gaps of the ground of drives. There must be no
/// mesh_obstacle(). UsageError naming --voxel if memory is short; InputError as the readers of
/// masks and boxes.
FieldMesh field_mesh(const Run& run, kernels::Backend& backend, const MeshOptions& options);

}  // namespace redrive
