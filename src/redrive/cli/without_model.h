// SPDX-License-Identifier: Apache-2.0
// A recording in place of a run, for commands that take both.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/base/error.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {

/// Whether the folder is a run, and no recording.
inline bool is_run_folder(const std::string& folder) {
  return std::filesystem::exists(RunPaths{folder}.config());
}

/// Returns a recording as a run without a model, over white where its images are transparent.
/// Throws InputError as open_recording.
inline Run open_without_model(const std::string& folder, int downscale = 1) {
  Run run;
  run.recording = open_recording(folder);
  SceneOptions options;
  options.downscale = downscale;
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
