// SPDX-License-Identifier: Apache-2.0
// redrive simulate: renders a run's whole drive anew, with labels, as a drive in a data set's
// format.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/cli/train/training.h"
#include "redrive/export/drive_path.h"
#include "redrive/export/simulate.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/calibration_json.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

struct SimulateCommandOptions : RenderOptions {
  SimulateOptions simulate;
  std::string format = "aimotive", labels = "flow", rig;
};

std::vector<std::string> names_of_formats() {
  std::vector<std::string> names;
  for (const DriveFormat& format : drive_formats()) names.emplace_back(format.name);
  return names;
}

/// Values of --labels; each has those before, too.
const std::vector<std::string> kLabels{"none", "masks", "flow", "guesses"};

/// Returns size and time of the last change of a file, and its path.
nlohmann::json stamp_of(const fs::path& file) {
  std::error_code error;
  const auto changed = fs::last_write_time(file, error).time_since_epoch();
  const std::uintmax_t bytes = fs::file_size(file, error);
  return {file.string(), error ? 0 : bytes, std::int64_t{changed.count()}};
}

/// Returns the options and files that rendered files depend on.
nlohmann::json plan_of(const SimulateCommandOptions& options, const Run& run,
                       const std::string& backend) {
  const LidarOptions& lidar = options.simulate.lidar;
  nlohmann::json field = nlohmann::json::array(), bodies = nlohmann::json::array();
  for (const fs::path& file : field_files(options.run)) field.push_back(stamp_of(file));
  if (!options.edit.empty())
    for (const AddedActor& added : read_traffic_edit(options.edit).added)
      bodies.push_back(stamp_of(added.change.body_file));
  const bool is_file = fs::is_regular_file(options.simulate.path);
  return {{"run", fs::weakly_canonical(fs::absolute(options.run)).string()},
          {"to", options.format},
          {"field", field},
          {"step", run.state.step},
          {"backend", backend},
          {"bodies", bodies},
          {"path", options.simulate.path},
          {"poses", is_file ? read_file(options.simulate.path) : ""},
          {"rig", options.rig.empty() ? "" : read_file(options.rig)},
          {"edit", options.edit.empty() ? "" : read_file(options.edit)},
          {"actors", options.actors},
          {"lidar", {options.simulate.with_lidar, lidar.sensor, lidar.mount, lidar.range}},
          {"labels", {options.simulate.labels, options.simulate.flow, options.simulate.guesses}}};
}

/// Returns the folder beside `out` that holds rendered files until the drive is complete. What an
/// earlier call with another plan left there is removed.
fs::path unfinished_folder(const fs::path& out, const nlohmann::json& plan) {
  fs::path folder = out;
  folder += ".unfinished";
  const fs::path file = folder / "plan.json";
  if (fs::exists(folder) && !fs::exists(file))
    throw UsageError("--out", folder.string(), "exists, and redrive did not make it");
  if (fs::exists(file)) {
    if (read_json(file) == plan) {
      std::printf("continues %s\n", folder.c_str());
      return folder;
    }
    fs::remove_all(folder);
  }
  make_folders(folder);
  write_file(file, plan.dump(1) + "\n");
  return folder;
}

/// Copies files of one folder into another: links where the file system has them.
void link_files(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::copy(from, to, fs::copy_options::recursive | fs::copy_options::create_hard_links, error);
  if (!error) return;
  fs::remove_all(to);
  fs::copy(from, to, fs::copy_options::recursive | fs::copy_options::overwrite_existing, error);
  if (error) throw IoError(to, error.message());
}

/// Adds "drive_file" to the images of COCO's document: the image in the drive's own folder.
/// `images`: DriveNotes::images, of files in `rendered`.
void name_images(const fs::path& file, const fs::path& rendered,
                 const std::map<fs::path, fs::path>& images) {
  nlohmann::json document = read_json(file);
  for (nlohmann::json& image : document.at("images")) {
    const auto written =
        images.find(rendered / image.at("camera").get<std::string>() /
                    (std::to_string(image.at("frame_id").get<std::int64_t>()) + ".png"));
    if (written != images.end()) image["drive_file"] = written->second.generic_string();
  }
  write_file(file, document.dump() + "\n");
}

void print_times(const SimulateTimes& times, std::size_t frames) {
  if (times.kept > 0) std::printf("%zu images were there\n", times.kept);
  if (times.images == 0) return;
  const double all_s = times.images_s + times.labels_s + times.files_s + times.scans_s;
  std::printf(
      "%s, %s in %.1f s, %.2f frames a second: images %.2f s, labels %.2f s, files %.2f s, scans "
      "%.2f s\n",
      counted(times.images, "image").c_str(), counted(times.scans, "scan").c_str(), all_s,
      static_cast<double>(frames) / all_s, times.images_s, times.labels_s, times.files_s,
      times.scans_s);
}

/// Returns the cameras of --rig; names its other sensors. InputError.
std::vector<CameraCalibration> read_rig(const fs::path& file) {
  OtherSensors others;
  std::vector<CameraCalibration> cameras = parse_calibration(read_file(file), file, &others);
  for (const std::string& name : others.names)
    std::printf("%s: %s is no camera and is not used; --sensor and --mount place a LiDAR\n",
                file.c_str(), name.c_str());
  for (const CameraCalibration& camera : cameras) {
    try {
      make_rig_camera(camera, {});
    } catch (const InputError& error) {
      throw InputError(file, error.field, error.value, error.rule);
    }
  }
  return cameras;
}

int run_simulate(SimulateCommandOptions options) {
  const fs::path out = fs::path(options.out).has_filename() ? fs::path(options.out)
                                                            : fs::path(options.out).parent_path();
  check_output_folder("--out", out, options.force);
  check_path(options.simulate.path);
  if (!options.rig.empty()) options.simulate.rig = read_rig(options.rig);
  if (options.simulate.with_lidar) parse_lidar_request(options.simulate.lidar);
  RunRenderer renderer(std::make_shared<const Run>(open_edited_run(options)), options.backend);
  const Run& run = renderer.run();
  if (!run.recording.metric)
    throw UsageError("RUN", options.run, "is of photographs; a drive has metres and times");
  Scene scene = scene_on_path(run.scene, options.simulate.path);
  if (!options.simulate.rig.empty()) scene = scene_with_rig(scene, options.simulate.rig);
  const std::string described = kernels::describe(renderer.backend());
  std::printf("%s\n", described.c_str());
  const fs::path folder = unfinished_folder(out, plan_of(options, run, described));
  const std::atomic<bool>& stop = stop_on_signal();
  SimulateTimes times;
  const auto format = std::ranges::find(drive_formats(), options.format, &DriveFormat::name);
  options.simulate.format = &*format;
  DriveNotes notes;
  const Recording drive = simulate(renderer, scene, options.simulate, folder, stop, &times, &notes);
  if (options.simulate.with_lidar && drive.lidars.empty())
    notes.left_out.emplace_back(
        "LiDAR: the run has no recorded scan; --sensor NAME, with --mount where it has no place, "
        "adds one");
  write_output_folder("--out", out, options.force, [&](const fs::path& made) {
    DriveNotes more = format->write(made, drive, renderer.backend().pool(), stop);
    std::ranges::copy(more.changed, std::back_inserter(notes.changed));
    std::ranges::copy(more.left_out, std::back_inserter(notes.left_out));
    if (!options.simulate.labels) return;
    link_files(folder / "labels", made / "labels");
    name_images(made / "labels/instances.json", folder / "images", more.images);
  });
  fs::remove_all(folder);
  print_times(times, scene.frames.size());
  std::printf("%s: %s of %s, %s\n", out.c_str(), counted(scene.frames.size(), "frame").c_str(),
              counted(drive.cameras.size(), "camera").c_str(), options.format.c_str());
  for (const std::string& what : notes.changed) std::printf("changed: %s\n", what.c_str());
  for (const std::string& what : notes.left_out) std::printf("not written: %s\n", what.c_str());
  return kExitOk;
}

}  // namespace

Action configure_simulate(CLI::App& command) {
  auto options = std::make_shared<SimulateCommandOptions>();
  SimulateOptions& simulate = options->simulate;
  add_run_option(command, &options->run);
  command
      .add_option(
          "--path", simulate.path,
          "drive (as driven), sideways:N (N metres to its left), speed:F (F times as fast "
          "along the same way), a .csv of places (t_s, x_m, y_m: seconds from the first frame, "
          "metres in the world), or a file of poses, egomotion.json as align writes it")
      ->capture_default_str();
  command
      .add_option("--rig", options->rig,
                  "cameras to render instead of the recording's, without their exposures: a "
                  "calibration.json, as export --to aimotive writes it")
      ->type_name("FILE");
  command
      .add_option("--to", options->format,
                  "layout of the drive: aimotive, kitti, kitti360, nuscenes, argoverse2 or ncore")
      ->check(one_of("--to", names_of_formats()))
      ->capture_default_str();
  command
      .add_option("--sensor", simulate.lidar.sensor,
                  "LiDAR: recorded (the rays that returned), estimated (the recording's beams, all "
                  "rays), a sensor as of render lidar, or none")
      ->capture_default_str();
  add_mount_option(command, &simulate.lidar.mount, "the LiDAR");
  command
      .add_option("--labels", options->labels,
                  "none; masks (2D boxes, instance masks, depth and poses); flow (also optical "
                  "flow); guesses (also masks of what no training image saw)")
      ->check(one_of("--labels", kLabels))
      ->capture_default_str();
  add_render_options(command, options.get(), "DIR", "folder for the drive, whole or not at all");
  return [options] {
    const auto labels = std::ranges::find(kLabels, options->labels) - kLabels.begin();
    options->simulate.labels = labels >= 1;
    options->simulate.flow = labels >= 2;
    options->simulate.guesses = labels >= 3;
    options->simulate.with_lidar = options->simulate.lidar.sensor != "none";
    return run_simulate(*options);
  };
}

}  // namespace redrive
