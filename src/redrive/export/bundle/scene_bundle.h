// SPDX-License-Identifier: Apache-2.0
// A scene bundle (FILE.usdz): the zip that AlpaSim and CARLA open beside a renderer's service.
//
//   metadata.yaml           scene_id, sensors, times (AlpaSim)
//   data_info.json          sequence_id, the same id; times (CARLA)
//   rig_trajectories.json   the rig's poses and cameras (both)
//   sequence_tracks.json    moving objects that the model draws (both)
//   mesh.ply, mesh_ground.ply   surfaces; the ground alone (AlpaSim's wheels)
//   map.xodr                the driven way (export/bundle/road_map.h; CARLA's world)
//   redrive/                the run, with recording.json in place of its recording
//
// Everything lies in the scene's world, as `redrive serve` has it: world_to_nre is the identity,
// T_world_base places the world on the Earth where the recording does.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "redrive/export/bundle/road_map.h"
#include "redrive/train/run.h"

namespace redrive {

/// Members of a bundle, beside kDataInfo and kRunOfBundle (render/open_to_render.h).
inline constexpr const char *kMetadata = "metadata.yaml",
                            *kRigTrajectories = "rig_trajectories.json",
                            *kSequenceTracks = "sequence_tracks.json", *kMesh = "mesh.ply",
                            *kGroundMesh = "mesh_ground.ply", *kMap = "map.xodr";
/// Key of the only part of sequence_tracks.json, which CARLA looks for.
inline constexpr const char* kTracksKey = "dummy_chunk_id";
/// Side of the voxels of a bundle's meshes: a drive of 200 m has about half a million triangles.
inline constexpr double kBundleVoxel_m = 0.2;

struct SceneBundleOptions {
  std::string scene_id, version;  ///< the scene's id; redrive's version
  double voxel_m = kBundleVoxel_m;
  std::uint64_t most_bytes = 0;  ///< memory that meshes may take while they are made
};

struct SceneBundle {
  std::vector<std::pair<std::string, std::string>> members;  ///< names and bytes
  std::size_t poses = 0, cameras = 0, tracks = 0, triangles = 0, ground_triangles = 0;
  RoadMap map;  ///< without its text; no roads: left out
};

/// Makes the members of a run's bundle. UsageError for a drive in blocks; InputError for
/// photographs and for a field without a surface; errors as field_mesh.
SceneBundle make_scene_bundle(const Run& run, kernels::Backend& backend,
                              const SceneBundleOptions& options);

}  // namespace redrive
