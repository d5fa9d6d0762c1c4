// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/training_data.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

/// `masks` and the recording's moving objects; nothing with --masks none.
Exclusions with_moving(const Run& run, const std::function<std::vector<Mask>()>& masks) {
  if (run.options.masks != "none")
    return {masks(), read_moving_objects(run.recording, run.scene).without(run.scene.actors)};
  std::vector<Mask> full;
  for (const RigCamera& rig : run.scene.rig)
    full.push_back(full_mask(rig.camera.width, rig.camera.height));
  return {full, MovingObjects({}, run.recording.frames, run.scene.global_from_world)};
}

/// The folder that --masks names, empty if none is.
std::filesystem::path mask_folder(const Run& run) {
  const std::string& given = run.options.masks;
  if (given == "auto" || given == "none") return {};
  if (!std::filesystem::is_directory(given))
    throw UsageError("--masks", given, "must be auto, none or a folder");
  if (std::ranges::none_of(run.scene.rig, [&](const RigCamera& rig) {
        return std::filesystem::exists(mask_file(given, rig));
      }))
    throw UsageError("--masks", given,
                     "holds no mask of a camera that is trained on, such as " +
                         mask_file("", run.scene.rig[0]).string());
  return given;
}

TrainingData applied(const Run& run, ThreadPool& pool, Exclusions left_out,
                     std::vector<Image8> images) {
  apply_masks(run.scene, left_out.masks, left_out.moving, pool, &images);
  if (!run.scene.actors.empty())
    mark_objects(run.scene, MovingObjects(run.scene.actors), pool, &images);
  LidarReturns lidar;
  if (run.state.model->uses_lidar()) {
    const MovingObjects moving =
        run.scene.actors.empty() ? left_out.moving : read_moving_objects(run.recording, run.scene);
    LidarSelection selection;
    if (run.state.holds_out_lidar)
      selection.frame = [held_out = held_out_frames(run.scene)](std::int64_t frame) {
        return !held_out.contains(frame);
      };
    lidar = load_lidar_returns(run.recording, run.scene, moving, pool, selection);
  }
  return {std::move(images), std::move(left_out), std::move(lidar)};
}

}  // namespace

Exclusions read_exclusions(const Run& run) {
  return with_moving(run, [&] { return read_masks(run.paths.masks(), run.scene); });
}

TrainingData load_training_data(const Run& run, ThreadPool& pool) {
  return applied(run, pool, read_exclusions(run), load_views(run.scene, pool));
}

TrainingData prepare_training_data(const Run& run, ThreadPool& pool) {
  const std::filesystem::path folder =
      mask_folder(run);  // first, so that a wrong folder is reported at once
  std::vector<Image8> images = load_views(run.scene, pool);
  Exclusions left_out = with_moving(
      run, [&] { return static_masks(run.scene, images, folder, pool, run.recording.metric); });
  return applied(run, pool, std::move(left_out), std::move(images));
}

void write_run_masks(const RunPaths& paths, const TrainingData& training, const Scene& scene) {
  std::error_code error;
  std::filesystem::create_directory(paths.masks(), error);
  if (error) throw IoError(paths.masks(), error.message());
  write_masks(paths.masks(), training.left_out.masks, scene);
}

}  // namespace redrive
