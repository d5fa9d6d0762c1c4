// SPDX-License-Identifier: Apache-2.0
// redrive align RECORDING [--out FOLDER]: aligns poses, extrinsics and time offsets to images and
// LiDAR.
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "redrive/align/align_summary.h"
#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/cli/alignment.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/json_output.h"
#include "redrive/cli/notes.h"
#include "redrive/recording/core/camera_choice.h"
#include "redrive/recording/core/readout_options.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

struct AlignArguments {
  std::string recording, frames, out;
  int threads = 0;
  double max_damaged = kMostDamagedPercent;
  AlignOptions options;
  std::vector<std::string> rolling_shutter, cameras;
  bool no_lidar = false, no_images = false, outside_files = false, json = false;
};

int run_align(AlignArguments arguments) {
  if (const int window = arguments.options.window; window != 0 && window < kMinWindow)
    throw UsageError("--window", std::to_string(window),
                     "must be 0 or " + std::to_string(kMinWindow) + " frames at least");
  if (std::filesystem::path& masks = arguments.options.tracks.masks; masks == "auto")
    masks.clear();
  else if (!masks.empty() && !std::filesystem::is_directory(masks))
    throw UsageError("--masks", masks.string(), "must be auto or a folder");
  if (!arguments.out.empty()) check_run_is_new(arguments.out);  // fails before minutes of work
  arguments.options.images = !arguments.no_images;
  arguments.options.lidar = !arguments.no_lidar;
  Recording recording =
      open_recording(arguments.recording, PoseSource::kRecorded, arguments.outside_files);
  keep_frames(parse_frame_range(arguments.frames), &recording);
  keep_cameras(arguments.cameras, &recording);
  require_few_damaged({.most_percent = arguments.max_damaged}, &recording);
  arguments.options.bundle.readouts = apply_readout_options(arguments.rolling_shutter, &recording);
  ThreadPool pool(arguments.threads > 0 ? arguments.threads : hardware_threads());
  if (arguments.options.lidar)
    if (const auto lost = lost_returns(sample_returns(recording, make_scene(recording, {}), pool)))
      recording.findings.push_back(*lost);
  if (!arguments.json) print_notes(recording);
  const AlignResult result = arguments.json ? align(recording, arguments.options, pool)
                                            : align_verbose(recording, arguments.options, pool);
  if (!arguments.out.empty()) write_alignment(arguments.out, recording, result);
  if (arguments.json) {
    nlohmann::json json = alignment_to_json(result);
    json["recording"] = recording.root.string();
    json["findings"] = findings_to_json(recording.findings);
    print_json(json);
  }
  if (arguments.out.empty() || arguments.json) return kExitOk;
  std::printf("%s: redrive train %s --poses %s\n",
              (std::filesystem::path(arguments.out) / "report.html").c_str(),
              arguments.recording.c_str(), arguments.out.c_str());
  return kExitOk;
}

}  // namespace

Action configure_align(CLI::App& command) {
  auto arguments = std::make_shared<AlignArguments>();
  command.add_option("RECORDING", arguments->recording, "folder of the recording")->required();
  add_frames_option(command, &arguments->frames);
  add_cameras_option(command, &arguments->cameras);
  add_outside_files_option(command, &arguments->outside_files);
  add_max_damaged_option(command, &arguments->max_damaged);
  command
      .add_option("--out", arguments->out,
                  "folder for poses, calibration and report.html; must not exist (default: prints "
                  "figures and writes nothing)")
      ->type_name("DIR");
  command
      .add_option("--masks", arguments->options.tracks.masks,
                  "auto: computes masks of the ego vehicle and broken rows; or a folder with "
                  "CAM.png as inspect "
                  "--masks-out writes them")
      ->default_str("auto");
  auto* no_lidar = command.add_flag("--no-lidar", arguments->no_lidar, "use images only");
  command
      .add_flag("--no-images", arguments->no_images,
                "use LiDAR only: aligns the trajectory, but no camera")
      ->excludes(no_lidar);
  command.add_flag("--intrinsics", arguments->options.bundle.intrinsics,
                   "also estimate focal length and principal point of each camera");
  command
      .add_option("--rolling-shutter", arguments->rolling_shutter,
                  "MS, or CAM:MS,CAM:MS: readout time of the rows, the middle one at the image's "
                  "time; negative: from the lowest row up. estimate, or CAM:estimate: estimates it "
                  "(default: readout_s of the calibration)")
      ->delimiter(',')
      ->allow_extra_args(false);
  command
      .add_option("--window", arguments->options.window,
                  "frames that are aligned at a time; a longer drive is aligned in windows that "
                  "overlap by a fifth and joined; 0: never")
      ->check(within("--window", 0, 1'000'000))
      ->capture_default_str();
  add_train_option(command, "threads", &arguments->threads);
  add_json_option(command, &arguments->json);
  return [arguments] { return run_align(*arguments); };
}

}  // namespace redrive
