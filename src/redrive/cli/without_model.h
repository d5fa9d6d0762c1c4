// SPDX-License-Identifier: Apache-2.0
// Opens a recording in place of a run, for commands that take both.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/base/error.h"
#include "redrive/cli/notes.h"
#include "redrive/recording/damaged_records.h"
#include "redrive/recording/frame_range.h"
#include "redrive/recording/pose_files.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {

/// Whether the folder is a run rather than a recording.
inline bool is_run_folder(const std::string& folder) {
  return std::filesystem::exists(RunPaths{folder}.config());
}

/// Returns a recording, or its `frames` (recording/frame_range.h), as a run without a model: with
/// the pose files of the folder `poses` if that is not empty, without damaged records
/// (DamageCheck::whole), over white where its images are transparent. Prints notes. Throws
/// InputError as open_recording and apply_pose_files.
inline Run open_without_model(const std::string& folder, int downscale = 1,
                              const std::string& frames = "", const std::string& poses = "",
                              bool outside_files = false, std::size_t whole = 0) {
  Run run;
  run.recording = open_recording(folder, PoseSource::kRecorded, outside_files);
  keep_frames(parse_frame_range(frames), &run.recording);
  require_few_damaged({.whole = whole}, &run.recording);
  if (!poses.empty())
    apply_pose_files(read_pose_files(run.recording, poses), poses, &run.recording);
  print_notes(run.recording);
  SceneOptions options;
  options.downscale = downscale;
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
