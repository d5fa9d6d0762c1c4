// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/open_to_render.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"
#include "redrive/base/memory_limit.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/render/divided_field.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/divided_run.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// blocks take this part of the allowed memory: one over it
constexpr std::uint64_t kCacheShare = 4;

std::shared_ptr<const LoadedBlock> load_block(const fs::path& whole, const Block& block,
                                              const Rigid3d& global_from_world) {
  const fs::path folder = block_folder(whole, block);
  const std::string resume = "redrive resume " + whole.string() + " trains it";
  if (!fs::exists(RunPaths{folder}.checkpoint()))
    throw InputError(folder, "", "", "block " + block.name + " is not trained; " + resume);
  auto loaded = std::make_shared<LoadedBlock>();
  try {
    Run run = open_run(folder);
    if (!run.scene.global_from_world.isApprox(global_from_world, 0))
      throw InputError(folder, "", "", "has another world than " + whole.string());
    loaded->model = std::move(run.state.model);
    loaded->scene = std::move(run.scene);
  } catch (const InputError& error) {
    throw InputError(folder, "", "",
                     "block " + block.name + " cannot be opened: " + error.what() +
                         "; remove its folder, then " + resume + " again");
  }
  loaded->scene.views = {};
  loaded->bytes = loaded->model->parameters.size() * sizeof(float);
  return loaded;
}

/// Copies how each block corrected the tracks of moving objects while its core was driven.
void correct_tracks(const DividedField& field, std::vector<MovingObject>* actors) {
  const DividedDrive& drive = field.drive();
  if (actors->empty()) return;
  for (int b = 0; b < drive.way.blocks(); ++b) {
    std::shared_ptr<const LoadedBlock> block;
    try {
      block = field.cache().get(b);
    } catch (const InputError&) {  // thrown again where an image needs the block
      continue;
    }
    for (MovingObject& actor : *actors) {
      const auto own = std::ranges::find(block->scene.actors, actor.id, &MovingObject::id);
      if (own == block->scene.actors.end() || own->corrections.size() != 6 * actor.keys.size())
        continue;
      actor.corrections.resize(own->corrections.size());
      for (std::size_t k = 0; k < actor.keys.size(); ++k)
        if (drive.block_at_time(actor.keys[k].t_ns) == b)
          std::copy_n(&own->corrections[6 * k], 6, &actor.corrections[6 * k]);
    }
  }
}

}  // namespace

Run open_to_render(const fs::path& root, std::optional<double> max_damaged) {
  if (is_scene_bundle(root)) {
    const auto zip = std::make_shared<ZipFile>(root);
    if (!zip->size(RunPaths{root / kRunOfBundle}.config()))
      throw InputError(root, kRunOfBundle, "",
                       "the bundle has no run of redrive, which export --to usdz-scene adds");
    mount(root, zip);
    return open_run(root / kRunOfBundle, /*to_resume=*/false, max_damaged);
  }
  if (!is_divided_run(root)) return open_run(root, /*to_resume=*/false, max_damaged);
  DividedRun whole = open_divided_run(root, max_damaged);
  Run run;
  run.paths = whole.paths;
  run.options = std::move(whole.options);
  run.recording = std::move(whole.recording);
  run.scene = std::move(whole.scene);

  std::vector<std::string> cameras;
  for (const RigCamera& camera : run.scene.rig) cameras.push_back(camera.name);
  std::vector<std::int64_t> t_ns;
  std::vector<Eigen::Vector3d> positions;
  for (const PosedFrame& frame : run.scene.posed_frames()) {
    t_ns.push_back(frame.t_ns);
    positions.push_back(frame.world_from_body.translation());
  }
  std::vector<std::size_t> last_core;
  for (const Block& block : whole.blocks)
    last_core.push_back(static_cast<std::size_t>(run.scene.frame_index(block.last_core)));
  if (last_core.back() + 1 != positions.size())
    throw InputError(blocks_file(root), "", "",
                     "its blocks end before the drive of " + run.recording.root.string());

  SeamExposure seams = read_seam_exposure(root, whole.blocks.size());
  set_gains(seams.lidar_gains, exposure_file(root), &run.recording);
  std::unique_ptr<Trainee> like = make_run_model(run.options, run.scene);
  record_hyperparameters(*like, &run.options);
  auto field = std::make_unique<DividedField>(
      std::move(like),
      DividedDrive{std::move(cameras), std::move(t_ns), BlockWay(positions, last_core),
                   std::move(seams)},
      [root, blocks = whole.blocks, global_from_world = run.scene.global_from_world](int b) {
        return load_block(root, blocks[b], global_from_world);
      },
      allowed_memory(run.options, memory_bytes()) / kCacheShare);
  const DividedField& divided = *field;
  run.blocks = std::move(whole.blocks);
  run.field_of_blocks = std::move(field);
  try {
    const BlockMetrics metrics = read_block_metrics(root);
    run.state.step = metrics.steps;
    run.state.seconds = metrics.seconds;
    // rows are for people to read: damaged ones do not prevent rendering
  } catch (const InputError&) {
  }
  load_actors(&run);
  correct_tracks(divided, &run.scene.actors);
  return run;
}

bool is_scene_bundle(const fs::path& path) {
  std::error_code error;
  return has_extension(path, {".usdz"}) && fs::is_regular_file(path, error);
}

std::optional<std::string> missing_part(const fs::path& root) {
  const bool bundle = is_scene_bundle(root);
  std::optional<ZipFile> zip;
  if (bundle) zip.emplace(root);
  const RunPaths paths{bundle ? root / kRunOfBundle : root};
  const auto has = [&](const fs::path& file) {
    return zip ? zip->size(file).has_value() : fs::exists(file);
  };
  if (!has(paths.config())) return "it has no run of redrive";
  const bool divided = !bundle && is_divided_run(root);
  if (!divided && !has(paths.checkpoint())) return "its run has no checkpoint";
  if (bundle && !has(paths.recording())) return "its run has no recording.json";
  return std::nullopt;
}

std::vector<fs::path> field_files(const fs::path& root) {
  if (is_scene_bundle(root)) return {root};
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root))
    if (entry.path().filename() == RunPaths{}.checkpoint().filename())
      files.push_back(entry.path());
  std::ranges::sort(files);
  return files;
}

bool is_run_folder(const fs::path& folder) { return fs::exists(RunPaths{folder}.config()); }

Run open_without_model(const WithoutModel& from) {
  Run run;
  run.recording = open_recording(from.folder, from.source, from.outside_files);
  keep_frames(parse_frame_range(from.frames), &run.recording);
  require_few_damaged(
      {.cameras = from.cameras, .most_percent = from.max_damaged, .whole = from.whole},
      &run.recording);
  if (!from.poses.empty())
    apply_pose_files(read_pose_files(run.recording, from.poses), from.poses, &run.recording);
  SceneOptions options;
  options.cameras = from.cameras;
  options.downscale = from.downscale;
  options.shown_only = true;
  run.scene = make_scene(run.recording, options);
  try {
    load_view(run.scene, run.scene.views.front());
  } catch (const UsageError&) {  // transparent images
    options.background = Background::kWhite;
    run.scene = make_scene(run.recording, options);
  }
  return run;
}

}  // namespace redrive
