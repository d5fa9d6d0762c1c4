// SPDX-License-Identifier: Apache-2.0
// Options of `redrive render` and the parts that single images and paths share.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"

namespace redrive {

struct RenderOptions {
  std::string run, camera, mount, lens, frame, translate = "0,0,0", axes = "body", exposure = "own",
                                               out, depth, opacity, normals, poses, path,
                                               actors = "all", edit;
  double yaw_deg = 0, pitch_deg = 0;
  double fps = 0, seconds = 0;  ///< of a path; 0: the path's own
  bool relative = false, force = false;
  kernels::BackendChoice backend;
};

/// Throws UsageError naming the run's cameras if it has no such camera.
const RigCamera& find_camera(const Scene& scene, const std::string& name);

/// Opens the run with the moving objects of --actors and the changes of --edit; prints remarks.
/// UsageError, InputError.
Run open_edited_run(const RenderOptions& options);

/// Returns what --exposure asks for; nothing for `own`. UsageError.
std::optional<Exposure> chosen_exposure(const RenderOptions& options, const Run& run);

/// Renders the images of --path into a video or a folder.
int render_path(const RenderOptions& options);

}  // namespace redrive
