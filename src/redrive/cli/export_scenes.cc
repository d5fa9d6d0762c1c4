// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/export_scenes.h"

#include <cstdio>
#include <filesystem>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"
#include "redrive/base/memory_limit.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/output_file.h"
#include "redrive/export/bundle/scene_bundle.h"
#include "redrive/export/bundle/splatsim_scene.h"
#include "redrive/export/mesh/surface_mesh.h"
#include "redrive/recording/core/wording.h"
#include "redrive/render/open_to_render.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

/// Writes a zip of these names and bytes; returns how many bytes.
std::size_t write_members(const std::string& out,
                          const std::vector<std::pair<std::string, std::string>>& members) {
  std::vector<ZipMember> of_zip;
  std::size_t bytes = 0;
  for (const auto& [name, content] : members) {
    of_zip.push_back({name, content});
    bytes += content.size();
  }
  write_zip(out, of_zip);
  return bytes;
}

/// Describes the lanes of a map.
std::string lanes_text(const RoadMap& map) {
  std::string text = map.measured == map.roads ? "lane between markings or kerbs"
                     : map.measured > 0
                         ? "lane between markings or kerbs, or of 3.5 m, as userData says"
                         : "lane of 3.5 m, which is assumed";
  for (const auto& [count, side] : {std::pair(map.left, "left"), std::pair(map.right, "right")})
    text += std::string(count > 0 ? ", a lane" : ", no lane") + " to its " + side +
            (count > 0 && count < map.roads ? " on " + counted(std::size_t(count), "road") : "");
  return text;
}

}  // namespace

void refuse_part_of_run(const ExportCommandOptions& options) {
  const char* rule = "is for recordings; a run has frames and poses of its own";
  if (!options.frames.empty()) throw UsageError("--frames", options.frames, rule);
  if (!options.poses.empty()) throw UsageError("--poses", options.poses, rule);
  if (options.outside_files) throw UsageError("--outside-files", "", rule);
}

int export_scene_bundle(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  refuse_part_of_run(options);
  if (!has_extension(options.out, {".usdz"}))
    throw UsageError("OUT", options.out, "a scene bundle must end in .usdz");
  if (const auto obstacle = mesh_obstacle()) throw UsageError("--to", options.format, *obstacle);
  const Run run = open_to_render(options.from, options.max_damaged);
  const auto backend = make_backend(options.backend, run.options.method);
  const std::filesystem::path from = std::filesystem::canonical(options.from);
  const std::string id = (is_scene_bundle(from) ? from.stem() : from.filename()).string();
  const SceneBundle bundle = make_scene_bundle(
      run, *backend,
      {id, REDRIVE_VERSION, options.voxel_m > 0 ? options.voxel_m : kBundleVoxel_m,
       allowed_memory(run.options, memory_bytes())});
  const std::size_t bytes = write_members(options.out, bundle.members);
  std::printf("scene %s: %zu poses, %s, %s; mesh: %zu triangles, of the ground %zu\n", id.c_str(),
              bundle.poses, counted(bundle.cameras, "camera").c_str(),
              counted(bundle.tracks, "moving object").c_str(), bundle.triangles,
              bundle.ground_triangles);
  const RoadMap& map = bundle.map;
  if (map.roads > 0)
    std::printf("map.xodr: %s, %.1f m, at most %.3f m beside the poses; %s\n",
                counted(static_cast<std::size_t>(map.roads), "road").c_str(), map.length_m,
                map.deviation_m, lanes_text(map).c_str());
  else
    std::printf(
        "not exported: map.xodr, since less than %g m were driven forward; CARLA needs it\n",
        kShortestRoad_m);
  if (map.reversed_m > 0)
    std::printf("not exported: %.1f m that were driven backwards, in map.xodr\n", map.reversed_m);
  std::printf("%s: %.1f MB\n", options.out.c_str(), 1e-6 * static_cast<double>(bytes));
  return kExitOk;
}

int export_splatsim(const ExportCommandOptions& options) {
  check_output_file("OUT", options.out, options.force);
  refuse_part_of_run(options);
  if (!has_extension(options.out, {".usdz"}))
    throw UsageError("OUT", options.out, "a scene of SplatSim must end in .usdz");
  const Run run = open_to_render(options.from, options.max_damaged);
  const FieldGaussians* const gaussians = run.field()->as_gaussians();
  if (!gaussians)
    throw UsageError("--to", options.format,
                     "has Gaussians, and the run is of method " + run.options.method);
  if (!run.scene.metric)
    throw InputError(options.from, "", "", "photographs have no metres, which a scene has");
  const WorldGaussians world = gaussians->world();
  SplatSimInput input{std::filesystem::path(options.out).stem().string(), REDRIVE_VERSION,
                      world.gaussians, options.encode.sh_degree, std::nullopt};
  if (run.recording.global_frame == GlobalFrame::kEcef)
    input.ecef_from_gaussians = run.scene.global_from_world;
  const SplatSimScene scene = make_splatsim_scene(input);
  const std::size_t bytes = write_members(options.out, scene.members);
  if (!run.scene.actors.empty())
    std::printf("not exported: moving objects; --actors ID with splat-spz has each\n");
  std::printf("%s: %zu Gaussians in %s, %s, %.1f MB\n", options.out.c_str(), world.gaussians.n,
              counted(scene.chunks, "chunk").c_str(),
              input.ecef_from_gaussians ? "placed on the Earth" : "with no place on the Earth",
              1e-6 * static_cast<double>(bytes));
  return kExitOk;
}

}  // namespace redrive
