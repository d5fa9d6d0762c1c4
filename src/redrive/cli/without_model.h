// SPDX-License-Identifier: Apache-2.0
// Opens a recording in place of a run, for commands that take both.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/base/error.h"
#include "redrive/cli/notes.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {

/// Whether the folder is a run rather than a recording.
inline bool is_run_folder(const std::string& folder) {
  return std::filesystem::exists(RunPaths{folder}.config());
}

/// What to open in place of a run.
struct WithoutModel {
  std::string folder;
  int downscale = 1;
  std::string frames = "",
              poses = "";  ///< recording/core/frame_range.h; a folder of pose files, or ""
  bool outside_files = false;
  double max_damaged = kMostDamagedPercent;
  std::size_t whole = 0;  ///< DamageCheck::whole
};

/// Returns a recording, with its poses replaced and without damaged records, as a run without a
/// model, over white where its images are transparent. Prints notes. Throws InputError as
/// open_recording and apply_pose_files.
inline Run open_without_model(const WithoutModel& from) {
  Run run;
  run.recording = open_recording(from.folder, PoseSource::kRecorded, from.outside_files);
  keep_frames(parse_frame_range(from.frames), &run.recording);
  require_few_damaged({.most_percent = from.max_damaged, .whole = from.whole}, &run.recording);
  if (!from.poses.empty())
    apply_pose_files(read_pose_files(run.recording, from.poses), from.poses, &run.recording);
  print_notes(run.recording);
  SceneOptions options;
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
