// SPDX-License-Identifier: Apache-2.0
// Options of `redrive render`, and code that single images, paths and LiDAR scans share.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "redrive/kernels/backend.h"
#include "redrive/render/lidar_sensor.h"
#include "redrive/render/view_pose.h"
#include "redrive/train/run.h"

namespace redrive {

struct RenderOptions {
  std::string run, camera, mount, lens, frame,
      translate = "0,0,0", axes = "body", exposure = "own", out, depth, opacity, normals, poses,
      path, actors = "all", edit, lidar, range = "0.5:200", points_in = "sensor";
  std::optional<int> azimuth_steps;  ///< firings in a turn of a SpinningLidar; nothing: its own
  std::optional<double> rate_hz;     ///< likewise
  std::optional<double> max_damaged;
  double yaw_deg = 0, pitch_deg = 0;
  double fps = 0, seconds = 0;  ///< images a second and duration of a path; 0: the path's own
  bool relative = false, force = false;
  kernels::BackendChoice backend;
};

/// Throws UsageError naming the run's cameras if it has no such camera.
const RigCamera& find_camera(const Scene& scene, const std::string& name);

/// Opens the run with the moving objects of --actors and the changes of --edit; prints remarks.
/// UsageError, InputError.
Run open_edited_run(const RenderOptions& options);

/// Returns the exposure that --exposure asks for; nothing for `own`. UsageError.
std::optional<Exposure> chosen_exposure(const RenderOptions& options, const Run& run);

/// Parses a decimal frame id, with or without leading zeros. UsageError.
std::int64_t parse_frame(const char* option, const std::string& text);

/// Parses the value of --translate. UsageError.
Eigen::Vector3d parse_translation(const std::string& text);

/// Returns the axes that --axes names. UsageError where the recording has none of that kind.
ShiftAxes shift_axes(const RenderOptions& options, const Run& run);

/// Throws UsageError for a frame that the recording does not have.
[[noreturn]] void no_such_frame(const std::string& frame, const Run& run);

/// Renders the images of --path into a video or a folder.
int render_path(const RenderOptions& options);

/// Renders the revolutions of --lidar into a point file or a folder.
int render_lidar(const RenderOptions& options);

}  // namespace redrive
