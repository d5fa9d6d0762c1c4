// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/surface_mesh.h"

#include "redrive/base/error.h"

#ifdef REDRIVE_OPENVDB

#include <algorithm>
#include <cmath>

#include <openvdb/openvdb.h>
#include <openvdb/tools/VolumeToMesh.h>

namespace redrive {
namespace {

openvdb::FloatGrid::Ptr as_grid(const TsdfVolume& volume) {
  static_assert(openvdb::FloatTree::LeafNodeType::SIZE == TsdfBlock::kPoints);
  // Unknown points count as outside. Faces towards them are dropped below.
  auto grid = openvdb::FloatGrid::create(static_cast<float>(volume.truncation_m()));
  for (const auto& block : volume.blocks()) {
    auto* leaf = grid->tree().touchLeaf({block->first.x(), block->first.y(), block->first.z()});
    for (int n = 0; n < TsdfBlock::kPoints; ++n)  // offsets are ours: z changes fastest
      if (block->weight[n] > 0)
        leaf->setValueOn(static_cast<openvdb::Index>(n), block->distance_m[n]);
  }
  return grid;
}

/// Returns the vertex at a position in voxels, or nothing if a point of its cell is unknown.
std::optional<PlyPoint> make_vertex(const TsdfVolume& volume, const Eigen::Vector3f& position) {
  const VoxelIndex first = position.array().floor().cast<int>();
  const Eigen::Vector3f fraction = position - first.cast<float>();
  Eigen::Vector3f rgb = Eigen::Vector3f::Zero();
  float sum = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const VoxelIndex to(corner >> 2, corner >> 1 & 1, corner & 1);
    const TsdfVolume::Point point = volume.find(first + to);
    if (!point.known()) return std::nullopt;
    if (!(point.block->rgb_weight[point.offset] > 0)) continue;
    float weight = 1e-6f;  // gives some colour even where the corners next to the vertex have none
    float product = 1;
    for (int k = 0; k < 3; ++k) product *= to[k] == 1 ? fraction[k] : 1 - fraction[k];
    weight += product;
    rgb += weight * Eigen::Map<const Eigen::Vector3f>(point.block->rgb[point.offset].data());
    sum += weight;
  }
  PlyPoint vertex{static_cast<float>(volume.voxel_m()) * position, Eigen::Vector3f::Zero(), {}};
  if (sum > 0)
    for (int c = 0; c < 3; ++c)
      vertex.rgb[c] = static_cast<std::uint8_t>(std::lround(std::clamp(rgb[c] / sum, 0.f, 255.f)));
  return vertex;
}

}  // namespace

std::optional<std::string> mesh_obstacle() { return std::nullopt; }

TriangleMesh surface_mesh(const TsdfVolume& volume, std::size_t least_triangles, ThreadPool& pool) {
  std::vector<openvdb::Vec3s> points;
  std::vector<openvdb::Vec4I> quads;
  // Runs within the pool's own threads: OpenVDB takes its caller's threads.
  pool.run(1, [&](int) { openvdb::tools::volumeToMesh(*as_grid(volume), points, quads); });

  TriangleMesh mesh;
  std::vector<bool> known(points.size());
  mesh.vertices.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto vertex = make_vertex(volume, {points[i].x(), points[i].y(), points[i].z()});
    known[i] = vertex.has_value();
    mesh.vertices.push_back(vertex ? *vertex : PlyPoint{Eigen::Vector3f::Zero(), {}, {}});
  }
  for (const openvdb::Vec4I& quad : quads) {
    bool all = true;
    for (int k = 0; k < 4; ++k) all &= known[quad[k]];
    if (!all) continue;
    mesh.triangles.push_back({quad[0], quad[1], quad[2]});
    mesh.triangles.push_back({quad[0], quad[2], quad[3]});
  }
  remove_small_pieces(least_triangles, &mesh);
  compute_normals(&mesh);
  return mesh;
}

}  // namespace redrive

#else  // REDRIVE_OPENVDB

namespace redrive {

std::optional<std::string> mesh_obstacle() {
  return "this program was built without libopenvdb-dev";
}

TriangleMesh surface_mesh(const TsdfVolume&, std::size_t, ThreadPool&) {
  REDRIVE_CHECK(!mesh_obstacle());
  return {};
}

}  // namespace redrive

#endif  // REDRIVE_OPENVDB
