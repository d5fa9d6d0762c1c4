// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/render/render_options.h"

#include <charconv>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/cli/actor_options.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/render/open_to_render.h"
#include "redrive/render/run_renderer.h"

namespace redrive {

void add_render_options(CLI::App& command, RenderOptions* options, const char* out,
                        const std::string& out_help) {
  command.add_option("--out", options->out, out_help)->type_name(out)->required();
  command.add_flag("--force", options->force, "overwrites what exists there");
  add_actor_options(command, &options->actors, &options->edit);
  add_max_damaged_option(command, &options->max_damaged);
  add_backend_options(command, &options->backend);
}

CLI::Option* add_motion_options(CLI::App& command, MovedSensorOptions* options) {
  CLI::Option* const frame = command.add_option(
      "--frame", options->frame, "frame id of the recording, whose pose the body has");
  command
      .add_option("--translate", options->translate,
                  "translation of the sensor by X,Y,Z metres along --axes")
      ->capture_default_str();
  command
      .add_option("--axes", options->axes,
                  "axes of --translate: body (x forward, y left, z up), camera (x right, y down, "
                  "z forward) or local (level: z up, x along the horizontal heading, y left)")
      ->check(one_of("--axes", {"body", "camera", "local"}))
      ->capture_default_str();
  command
      .add_option("--yaw", options->yaw_deg,
                  "turns the sensor about z of the body, degrees, to the left")
      ->check(within("--yaw", -360.0, 360.0));
  command
      .add_option("--pitch", options->pitch_deg,
                  "then turns it about x of the camera, degrees, upwards")
      ->check(within("--pitch", -360.0, 360.0));
  return frame;
}

void add_exposure_option(CLI::App& command, std::string* exposure, const std::string& own) {
  command
      .add_option("--exposure", *exposure,
                  "exposure, white balance and shading of the image: own (" + own +
                      "), none (the field's colours unchanged) or those of CAMERA:FRAME")
      ->capture_default_str();
}

CLI::Option* add_mount_option(CLI::App& command, std::string* mount, const std::string& what) {
  return command.add_option(
      "--mount", *mount,
      "place of " + what +
          " on the car: metres along the body's axes (x forward, y left, z up) and degrees (to "
          "the left, upwards, clockwise); zeros look forward");
}

const RigCamera& find_camera(const Scene& scene, const std::string& name) {
  const int index = scene.camera_index(name);
  if (index >= 0) return scene.rig[index];
  throw UsageError("--camera", name, unknown_camera(name, scene.rig));
}

Mount parsed_mount(const std::string& text) {
  if (const std::optional<Mount> mount = parse_mount(text)) return *mount;
  throw UsageError("--mount", text, kMountRule);
}

Run open_edited_run(const RenderOptions& options) {
  std::optional<TrafficEdit> edit;
  if (!options.edit.empty()) edit = read_traffic_edit(options.edit);
  Run run = open_to_render(options.run, options.max_damaged);
  for (const std::string& remark : change_traffic(*run.field(), edit, options.actors, &run.scene))
    std::printf("%s: %s\n", options.edit.c_str(), remark.c_str());
  return run;
}

Eigen::Vector3d parse_translation(const std::string& text) {
  const char* rule = "must be three numbers X,Y,Z in metres, at most 1e4 each, e.g. 0.5,0,0";
  Eigen::Vector3d shift_m;
  const char *at = text.data(), *end = text.data() + text.size();
  for (int i = 0; i < 3; ++i) {
    const auto [next, error] = std::from_chars(at, end, shift_m[i]);
    const bool comma = next != end && *next == ',';
    if (error != std::errc{} || !(std::abs(shift_m[i]) <= kMaxShift_m) ||
        (i < 2 ? !comma : next != end))
      throw UsageError("--translate", text, rule);
    at = next + (i < 2);
  }
  return shift_m;
}

SensorShift sensor_shift(const MovedSensorOptions& options, const Run& run) {
  return {parse_translation(options.translate), shift_axes(options.axes, run.recording),
          options.yaw_deg, options.pitch_deg};
}

void no_such_frame(const std::string& frame, const Run& run) {
  throw UsageError("--frame", frame, unknown_frame(parse_frame("--frame", frame), run.scene));
}

}  // namespace redrive
