// SPDX-License-Identifier: Apache-2.0
// Presets and the rules that tie options together; the options themselves stand in
// option_fields.cc.
#include "redrive/train/options.h"

#include <algorithm>
#include <charconv>
#include <functional>
#include <limits>
#include <set>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/field/grid_field.h"
#include "redrive/recording/readout_options.h"

namespace redrive {
namespace {

constexpr const char* kFrontCamera = "F_MIDLONGRANGECAM_CL";
constexpr const char* kSecondCamera = "F_MIDRANGECAM_C";
constexpr const char* kSecondCameraInstead = "B_MIDRANGECAM_C";

/// Samples of a batch: the step keeps about 60 bytes for each (t, dt, weights, raw outputs and
/// their derivatives, twice with a fine network), so 2^22 of them stay within a quarter of a
/// gigabyte.
constexpr std::int64_t kMaxBatchSamples = std::int64_t{1} << 22;

struct FrameRange {
  std::int64_t first = -1, last = -1;
  int step = 1;
};

FrameRange parse_frames(const std::string& text) {
  FrameRange range;
  if (text.empty()) return range;
  const auto fail = [&](const char* rule) { throw UsageError("--frames", text, rule); };
  const auto number = [&](std::string_view part, std::int64_t low) {
    std::int64_t value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error != std::errc() || end != part.data() + part.size() || value < low ||
        value > 1'000'000'000'000)
      fail("must be FIRST:LAST[:STEP], frame ids (either may be empty) and a step of 1 or more");
    return value;
  };
  std::vector<std::string_view> parts;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(':', begin), text.size());
    parts.push_back(std::string_view(text).substr(begin, end - begin));
    begin = end + 1;
  }
  if (parts.size() < 2 || parts.size() > 3) fail("must be FIRST:LAST[:STEP]");
  if (!parts[0].empty()) range.first = number(parts[0], 0);
  if (!parts[1].empty()) range.last = number(parts[1], 0);
  if (parts.size() == 3)
    range.step = static_cast<int>(std::min<std::int64_t>(number(parts[2], 1), 1'000'000'000));
  if (range.first >= 0 && range.last >= 0 && range.last < range.first)
    fail("LAST must not be before FIRST");
  return range;
}

}  // namespace

void apply_preset(TrainOptions* options, const std::vector<std::string>& given) {
  const auto is_given = [&](const char* name) {
    return std::find(given.begin(), given.end(), name) != given.end();
  };
  const auto set = [&](const char* name, auto& field, auto value) {
    if (!is_given(name)) field = value;
  };
  const std::string& preset = options->preset;
  const bool report = preset == "report-1" || preset == "report-2",
             timed = preset == "fast" || preset == "best";
  if (!preset.empty() && !report && !timed)
    throw UsageError("--preset", preset, "unknown; known are report-1, report-2, fast and best");
  if (report) set("method", options->method, "nerf");
  if (options->method != (report ? "nerf" : timed ? "grid" : options->method))
    throw UsageError("--preset", preset, "is not one of --method " + options->method);
  if (options->method == "grid") {
    if (preset == "fast") set("max-seconds", options->max_seconds, 60.0);
    if (preset == "best") set("max-seconds", options->max_seconds, 1200.0);
    if (is_given("epochs") || is_given("max-steps")) set("max-seconds", options->max_seconds, 0.0);
    return;
  }
  const bool second = preset == "report-2";
  set("near", options->near_m, 1.0);
  set("far", options->far_m, 10.0);
  set("width", options->width, second ? 128 : 256);
  set("samples", options->samples, second ? 48 : 96);
  set("batch", options->batch_rays, 1024);
  set("error-rays", options->error_rays, 0.0);
  set("lidar-rays", options->lidar_rays, 0);
  set("learning-rate", options->learning_rate, 5e-4);
  set("lr-gamma", options->lr_gamma, 0.5);
  set("epochs", options->epochs, second ? 2 : 4);
  set("max-seconds", options->max_seconds, 0.0);
  if (report) set("masks", options->masks, "none");
}

void resolve_cameras(TrainOptions* options, const Recording& recording) {
  const bool second = options->preset == "report-2";
  if (!options->cameras.empty() || (options->preset != "report-1" && !second)) return;
  options->cameras = {kFrontCamera};
  if (second)
    options->cameras.push_back(recording.find_camera(kSecondCamera) ? kSecondCamera
                                                                    : kSecondCameraInstead);
}

void resolve_bounds(TrainOptions* options, const std::vector<std::string>& given,
                    const Recording& recording) {
  const auto is_given = [&](const char* name) {
    return std::find(given.begin(), given.end(), name) != given.end();
  };
  if (!recording.bounds || options->preset.starts_with("report")) return;
  // Of the half side: cameras inside the cube have it all around them; a pixel is the same a
  // hundred cubes away and further.
  constexpr double kLeast = 0.02, kFurthest = 100;
  constexpr int kWidth = 64;
  const auto& [center, half_side] = *recording.bounds;
  double nearest = std::numeric_limits<double>::infinity(), furthest = 0;
  for (const FramePose& frame : recording.frames) {
    const Eigen::Vector3d place = (frame.global_from_body.translation() - center).cwiseAbs();
    nearest = std::min(nearest, (place.array() - half_side).max(0).matrix().norm());
    furthest = std::max(furthest, (place.array() + half_side).matrix().norm());
  }
  // The grid contracts what is beyond the cube, where cameras within it see that.
  const bool grid = options->method == "grid",
             unbounded = grid && nearest == 0 && options->background.empty();
  if (grid && !unbounded && !is_given("width")) options->width = kWidth;
  if (is_given("near") || is_given("far")) return;
  options->near_m = std::max(nearest, kLeast * half_side);
  options->far_m = unbounded ? kFurthest * half_side : furthest;
}

bool refines_poses(const TrainOptions& options, const Scene& scene) {
  if (options.refine_poses == "on" && !scene.metric)
    throw UsageError("--refine-poses", "on",
                     "poses are refined of drives alone, which have metres and a clock");
  const bool by_default = options.method == "grid" && scene.metric && !options.ground_truth_poses;
  return options.refine_poses == "on" || (options.refine_poses == "auto" && by_default);
}

void validate(const TrainOptions& options) {
  for (const TrainField& field : train_fields()) {
    field.check(options);
    nlohmann::json json;
    field.save(options, json);
    try {
      json.dump();  // as config.json will need it
    } catch (const nlohmann::json::type_error&) {
      const std::string flag = std::string("--").append(field.name);
      throw UsageError(field.name == "recording" ? "RECORDING" : flag, "",
                       "must be UTF-8 text, as config.json is");
    }
  }
  if (options.far_m <= options.near_m)
    throw UsageError("--far", std::to_string(options.far_m),
                     "must be greater than --near " + std::to_string(options.near_m));
  if (options.method == "grid") {
    if (options.fine_samples > 0)
      throw UsageError("--fine-samples", std::to_string(options.fine_samples),
                       "belongs to --method nerf");
    if (options.width > kMaxGridWidth)
      throw UsageError("--width", std::to_string(options.width),
                       "must be " + std::to_string(kMaxGridWidth) + " or less with --method grid");
    if (!options.lr_milestones.empty())
      throw UsageError("--lr-milestones", "",
                       "belong to --method nerf; --lr-gamma says what the rate ends at");
  }
  if (options.method == "nerf" && options.error_rays > 0)
    throw UsageError("--error-rays", std::to_string(options.error_rays), "belong to --method grid");
  if (options.method == "nerf" && options.background == "random")
    throw UsageError("--background", "random",
                     "is not for --method nerf, which knows no background; white or black");
  if (options.ground_truth_poses + options.align + !options.poses.empty() > 1)
    throw UsageError(options.align ? "--align" : "--poses", options.poses,
                     "--truth-poses, --poses and --align exclude each other");
  if (estimates_readouts(options.rolling_shutter) && !options.align)
    throw UsageError("--rolling-shutter", "estimate",
                     "needs --align, which estimates; or redrive align --rolling-shutter estimate, "
                     "then --poses");
  if (options.holdout_every == 1)
    throw UsageError("--holdout-every", "1", "would leave nothing to train on; 0 or 2 and more");
  parse_frames(options.frames);
  allowed_memory(options, 1'000'000'000);
  allowed_gpu_memory(options, 1'000'000'000);
  const std::set<std::string> distinct(options.cameras.begin(), options.cameras.end());
  if (distinct.size() != options.cameras.size() || distinct.count(""))
    throw UsageError("--cameras", "", "must be names of cameras, each once, separated by commas");
  const std::vector<std::int64_t>& steps = options.lr_milestones;
  if (std::ranges::adjacent_find(steps, std::greater_equal<>()) != steps.end() ||
      (!steps.empty() && steps.front() < 1)) {
    std::string list;
    for (const std::int64_t step : steps)
      list.append(list.empty() ? "" : ",").append(std::to_string(step));
    throw UsageError("--lr-milestones", list, "must be steps of 1 or more, ascending");
  }
  const std::int64_t samples =
      std::int64_t{options.batch_rays} * (options.samples + options.fine_samples);
  if (samples > kMaxBatchSamples)
    throw UsageError("--batch", std::to_string(options.batch_rays),
                     "times samples a ray is " + std::to_string(samples) + ", must be " +
                         std::to_string(kMaxBatchSamples) + " or less (memory)");
}

Recording open_recording(const TrainOptions& options) {
  Recording recording =
      open_recording(options.recording,
                     options.ground_truth_poses ? PoseSource::kGroundTruth : PoseSource::kRecorded);
  apply_readout_options(options.rolling_shutter, &recording);
  return recording;
}

bool has_external_poses(const TrainOptions& options) {
  return options.align || !options.poses.empty();
}

void use_external_poses(const PoseFiles& files, const std::filesystem::path& folder,
                        const TrainOptions& options, Recording* recording) {
  apply_pose_files(files, folder, recording);
  apply_readout_options(options.rolling_shutter, recording);
}

SceneOptions scene_options(const TrainOptions& options) {
  const FrameRange frames = parse_frames(options.frames);
  SceneOptions scene;
  scene.cameras = options.cameras;
  scene.first_frame = frames.first;
  scene.last_frame = frames.last;
  scene.frame_step = frames.step;
  scene.downscale = options.downscale;
  scene.holdout_every = options.holdout_every;
  scene.undistort = options.undistort;
  scene.near_m = options.near_m;
  scene.far_m = options.far_m;
  if (options.background == "white") scene.background = Background::kWhite;
  if (options.background == "black" || options.background == "random")
    scene.background = Background::kBlack;
  scene.random_background = options.method == "grid" && scene.background != Background::kNone;
  return scene;
}

namespace {

/// Of `all` bytes, which are `what`.
std::uint64_t allowed_of(const char* option, const std::string& text, std::uint64_t all,
                         const char* what) {
  constexpr double kGiB = 1024.0 * 1024 * 1024;
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const std::string unit(end, text.data() + text.size());
  const double bytes = unit == ""      ? value
                       : unit == "GiB" ? kGiB * value
                                       : 0.01 * value * static_cast<double>(all);
  if (error != std::errc() || !(bytes >= 1 && bytes < 1e18) ||
      (unit != "" && unit != "GiB" && unit != "%"))
    throw UsageError(
        option, text,
        std::string("must be bytes, or a number with GiB or % (of ") + what + ") behind it");
  return static_cast<std::uint64_t>(bytes);
}

}  // namespace

std::uint64_t allowed_memory(const TrainOptions& options, std::uint64_t machine) {
  return allowed_of("--memory", options.memory, machine, "the machine's memory");
}

std::uint64_t allowed_gpu_memory(const TrainOptions& options, std::uint64_t free) {
  return allowed_of("--gpu-memory", options.gpu_memory, free, "what the GPU has free");
}

std::int64_t total_steps(const TrainOptions& options, std::int64_t steps_per_epoch) {
  const std::int64_t steps = options.epochs * steps_per_epoch;
  return options.max_steps > 0 ? std::min(steps, options.max_steps) : steps;
}

std::vector<std::int64_t> milestones(const TrainOptions& options, std::int64_t steps_per_epoch) {
  if (!options.lr_milestones.empty()) return options.lr_milestones;
  const std::int64_t steps = total_steps(options, steps_per_epoch);
  if (steps < 8) return {};  // the fractions would fall together, or on step 0
  return {steps / 2, steps * 3 / 4, steps * 7 / 8};
}

nlohmann::json options_to_json(const TrainOptions& options) {
  nlohmann::json json = nlohmann::json::object();
  for (const TrainField& field : train_fields()) field.save(options, json);
  return json;
}

TrainOptions options_from_json(const nlohmann::json& json, const std::filesystem::path& file) {
  if (!json.is_object())
    throw InputError(file, "", json.type_name(), "must be an object with the options of a run");
  const std::vector<TrainField>& fields = train_fields();
  for (const auto& [key, value] : json.items())
    if (std::none_of(fields.begin(), fields.end(),
                     [&key = key](const TrainField& field) { return field.name == key; }))
      throw InputError(file, key, value.dump().substr(0, 80), "unknown option");
  TrainOptions options;
  for (const TrainField& field : fields) {
    if (!json.contains(field.name)) throw InputError(file, field.name, "", "missing");
    try {
      field.load(options, json);
    } catch (const UsageError& error) {
      throw InputError(file, field.name, "", error.what());
    }
  }
  try {
    validate(options);
  } catch (const UsageError& error) {
    throw InputError(file, "", "", error.what());
  }
  return options;
}

}  // namespace redrive
