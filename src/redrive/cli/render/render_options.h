// SPDX-License-Identifier: Apache-2.0
// Options that subcommands of `redrive render` share, and code for them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <CLI/App.hpp>

#include "redrive/kernels/backend.h"
#include "redrive/render/view_pose.h"
#include "redrive/train/run.h"

namespace redrive {

/// Options of every subcommand.
struct RenderOptions {
  std::string run, actors = "all", edit, out;
  std::optional<double> max_damaged;
  bool force = false;
  kernels::BackendChoice backend;
};

/// Options of a camera or a LiDAR that is moved from its place at a frame.
struct MovedSensorOptions : RenderOptions {
  std::string frame, translate = "0,0,0", axes = "body";
  double yaw_deg = 0, pitch_deg = 0;
};

/// Adds the options of every subcommand but RUN, which comes before other positional arguments.
void add_render_options(CLI::App& command, RenderOptions* options, const char* out,
                        const std::string& out_help);
/// Adds --frame, --translate, --axes, --yaw and --pitch. Returns --frame.
CLI::Option* add_motion_options(CLI::App& command, MovedSensorOptions* options);
/// Adds --exposure. `own`: whose exposure an image has by default.
void add_exposure_option(CLI::App& command, std::string* exposure, const std::string& own);
/// Adds --mount. `what`: what is mounted.
CLI::Option* add_mount_option(CLI::App& command, std::string* mount, const std::string& what);

/// Throws UsageError naming the run's cameras if it has no such camera.
const RigCamera& find_camera(const Scene& scene, const std::string& name);

/// Returns the place of --mount. UsageError.
Mount parsed_mount(const std::string& text);

/// Opens the run with the moving objects of --actors and the changes of --edit; prints remarks.
/// UsageError, InputError.
Run open_edited_run(const RenderOptions& options);

/// Parses the value of --translate. UsageError.
Eigen::Vector3d parse_translation(const std::string& text);

/// Returns --translate, --axes, --yaw and --pitch. UsageError.
SensorShift sensor_shift(const MovedSensorOptions& options, const Run& run);

/// Throws UsageError for a frame that the recording does not have.
[[noreturn]] void no_such_frame(const std::string& frame, const Run& run);

}  // namespace redrive
