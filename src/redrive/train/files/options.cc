// SPDX-License-Identifier: Apache-2.0
// Presets and rules that involve several options; the list of options is in option_fields.cc.
#include "redrive/train/files/options.h"

#include <algorithm>
#include <charconv>
#include <functional>
#include <limits>
#include <set>

#include <nlohmann/json.hpp>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/recording/core/camera_choice.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/readout_options.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"

namespace redrive {
namespace {

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::ranges::find(names, name) != names.end();
}

const Preset* find_preset(const Method& method, const std::string& name) {
  const auto found = std::ranges::find(method.presets, name, &Preset::name);
  return found == method.presets.end() ? nullptr : &*found;
}
/// Returns null if none is chosen or it is unknown.
const Preset* find_preset(const TrainOptions& options) {
  const Method* method = find_method(options.method);
  return method ? find_preset(*method, options.preset) : nullptr;
}

/// Sets the options that neither `given` nor --set names.
void set_defaults(const OptionValues& values, const std::vector<std::string>& given,
                  TrainOptions* options) {
  const std::vector<TrainField> fields = train_fields();
  for (const auto& [name, text] : values) {
    const auto field = std::ranges::find(fields, name, &TrainField::name);
    REDRIVE_CHECK(field != fields.end());
    if (!contains(given, name) && !options->hyperparameters.contains(field->hyperparameter))
      field->parse(*options, text);
  }
}

}  // namespace

void apply_preset(TrainOptions* options, const std::vector<std::string>& given) {
  if (!options->preset.empty() && !find_preset(*options)) {
    // Without --method the method of the preset is meant.
    std::vector<std::string> known;
    const Method* of_preset = nullptr;
    for (const Method& method : methods()) {
      for (const Preset& preset : method.presets)
        if (!contains(known, preset.name)) known.push_back(preset.name);
      if (!of_preset && find_preset(method, options->preset)) of_preset = &method;
    }
    if (!of_preset)
      throw UsageError("--preset", options->preset, unknown_name(options->preset, known));
    if (contains(given, "method"))
      throw UsageError("--preset", options->preset, "is not one of --method " + options->method);
    options->method = of_preset->name;
  }
  const Method* method = find_method(options->method);
  if (!method) return;  // validate() rejects it
  set_defaults(method->defaults, given, options);
  const Preset* preset = find_preset(*options);
  const auto set_preset = [&] {
    if (preset) set_defaults(preset->values, given, options);
  };
  set_preset();
  if ((contains(given, "epochs") || contains(given, "max-steps")) &&
      !contains(given, "max-seconds"))
    options->max_seconds = 0;
  if (method->defaults_of_time && options->max_seconds > 0) {
    set_defaults(method->defaults_of_time(options->max_seconds), given, options);
    set_preset();
  }
}

void resolve_cameras(TrainOptions* options, Recording* recording) {
  if (!options->cameras.empty()) return;
  if (const Preset* preset = find_preset(*options))
    for (const std::vector<std::string>& choices : preset->cameras) {
      const auto found = std::ranges::find_if(
          choices, [&](const std::string& name) { return recording->find_camera(name); });
      options->cameras.push_back(found != choices.end() ? *found : choices.back());
    }
  if (!options->cameras.empty()) return;
  const std::vector<std::string> grey = grey_cameras(*recording);
  if (grey.empty() || grey.size() == recording->cameras.size()) return;
  const FrameRange frames = parse_frame_range(options->frames);
  const auto is_chosen = [&](const ImageFile& image) {
    return image.frame_id >= frames.first && (frames.last < 0 || image.frame_id <= frames.last);
  };
  for (const RecordedCamera& camera : recording->cameras)
    if (const std::string& name = camera.calibration.name;
        !contains(grey, name) && std::ranges::any_of(camera.images, is_chosen))
      options->cameras.push_back(name);
  if (options->cameras.empty()) return;
  recording->findings.push_back(
      {first_few(grey), "left out beside colour cameras, grey; --cameras takes them, too"});
}

void resolve_bounds(TrainOptions* options, const std::vector<std::string>& given,
                    const Recording& recording) {
  const Preset* preset = find_preset(*options);
  const auto is_given = [&](const std::string& name) {
    return contains(given, name) ||
           (preset && std::ranges::any_of(preset->values,
                                          [&](const auto& value) { return value.first == name; }));
  };
  if (!recording.bounds || is_given("near") || is_given("far")) return;
  // Factor of the half side: cameras inside the cube also see beyond it; beyond a hundred cubes
  // parallax is negligible.
  constexpr double kMinNear = 0.02, kMaxFar = 100;
  const auto& [center, half_side] = *recording.bounds;
  double nearest = std::numeric_limits<double>::infinity(), furthest = 0;
  for (const FramePose& frame : recording.frames) {
    const Eigen::Vector3d distance = (frame.global_from_body.translation() - center).cwiseAbs();
    nearest = std::min(nearest, (distance.array() - half_side).max(0).matrix().norm());
    furthest = std::max(furthest, (distance.array() + half_side).matrix().norm());
  }
  const Method* method = find_method(options->method);
  const bool unbounded =
      method && method->contracts_space && nearest == 0 && options->background.empty();
  options->near_m = std::max(nearest, kMinNear * half_side);
  options->far_m = unbounded ? kMaxFar * half_side : furthest;
}

void apply_hyperparameters(const TrainOptions& options, Trainee* model) {
  PoseRefinement unused;
  for (const auto& [name, text] : options.hyperparameters) {
    if (set_hyperparameter(*model, name, text) || set_hyperparameter(unused, name, text)) continue;
    for (const Method& method : methods())
      for (const HyperparameterValue& value : hyperparameter_values(*method.make()))
        if (value.what.name == name)
          throw UsageError(value.what.flag(), text, "belongs to --method " + method.name);
    std::vector<std::string> known;
    for (Configurable* numbers :
         {static_cast<Configurable*>(model), static_cast<Configurable*>(&unused)})
      for (const HyperparameterValue& value : hyperparameter_values(*numbers))
        if (!value.what.derived) known.push_back(value.what.name);
    throw UsageError("--set", name + "=" + text,
                     unknown_name(name, known) + " (--method " + options.method + ")");
  }
  model->check([](const Hyperparameter& what, const std::string& value, const std::string& rule) {
    throw UsageError(what.flag(), value, rule);
  });
}

void record_hyperparameters(Trainee& model, TrainOptions* options) {
  auto& given = options->hyperparameters;
  PoseRefinement refinement = pose_refinement(*options);
  for (Configurable* numbers :
       {static_cast<Configurable*>(&model), static_cast<Configurable*>(&refinement)})
    for (const HyperparameterValue& value : hyperparameter_values(*numbers))
      if (!value.what.option.empty() || given.contains(value.what.name))
        given[value.what.name] = value.text;
}

PoseRefinement pose_refinement(const TrainOptions& options) {
  PoseRefinement refinement;
  for (const auto& [name, text] : options.hyperparameters)
    set_hyperparameter(refinement, name, text);
  return refinement;
}

bool refines_poses(const TrainOptions& options, const Scene& scene) {
  if (options.refine_poses == "on" && !scene.metric)
    throw UsageError("--refine-poses", "on",
                     "only poses of drives can be refined, which have metric scale and timestamps");
  const Method* method = find_method(options.method);
  const bool by_default =
      method && method->refines_poses && scene.metric && !options.ground_truth_poses;
  return options.refine_poses == "on" || (options.refine_poses == "auto" && by_default);
}

void validate_fields(const TrainOptions& options) {
  for (const TrainField& field : train_fields()) {
    field.check(options);
    nlohmann::json json;
    field.save(options, json);
    try {
      json.dump();  // throws for text that is not UTF-8
    } catch (const nlohmann::json::type_error&) {
      const std::string flag = std::string("--").append(field.name);
      throw UsageError(field.name == "recording" ? "RECORDING" : flag, "",
                       "must be UTF-8 text, as config.json is");
    }
  }
}

void validate(const TrainOptions& options) {
  validate_fields(options);
  if (options.far_m <= options.near_m)
    throw UsageError("--far", std::to_string(options.far_m),
                     "must be greater than --near " + std::to_string(options.near_m));
  const Method& method = *find_method(options.method);
  apply_hyperparameters(options, method.make().get());
  if (options.background == "random" && !method.random_background)
    throw UsageError(
        "--background", "random",
        "is not for --method " + method.name + ", which knows no background; white or black");
  if (options.ground_truth_poses + options.align + !options.poses.empty() > 1)
    throw UsageError(options.align ? "--align" : "--poses", options.poses,
                     "--truth-poses, --poses and --align exclude each other");
  if (estimates_readouts(options.rolling_shutter) && !options.align)
    throw UsageError("--rolling-shutter", "estimate",
                     "needs --align, which estimates; or redrive align --rolling-shutter estimate, "
                     "then --poses");
  if (options.holdout_every == 1)
    throw UsageError("--holdout-every", "1", "would leave nothing to train on; 0 or 2 and more");
  if (options.train_every == 1)
    throw UsageError("--train-every", "1", "would keep nothing for eval; 0 or 2 and more");
  if (options.holdout_every > 0 && options.train_every > 0)
    throw UsageError("--train-every", std::to_string(options.train_every),
                     "and --holdout-every exclude each other");
  parse_frame_range(options.frames);
  allowed_memory(options, 1'000'000'000);
  allowed_device_memory(options, 1'000'000'000);
  const std::set<std::string> distinct(options.cameras.begin(), options.cameras.end());
  if (distinct.size() != options.cameras.size() || distinct.count(""))
    throw UsageError("--cameras", "", "must be names of cameras, each once, separated by commas");
}

Recording open_recording(const TrainOptions& options) {
  Recording recording =
      open_recording(options.recording,
                     options.ground_truth_poses ? PoseSource::kGroundTruth : PoseSource::kRecorded,
                     options.outside_files);
  require_few_damaged({parse_frame_range(options.frames), options.cameras, options.max_damaged, 0},
                      &recording);
  apply_readout_options(options.rolling_shutter, &recording);
  return recording;
}

bool has_external_poses(const TrainOptions& options) {
  return options.align || !options.poses.empty();
}

void use_external_poses(const PoseFiles& files, const std::filesystem::path& folder,
                        const TrainOptions& options, Recording* recording) {
  apply_pose_files(files, folder, recording, parse_frame_range(options.frames));
  apply_readout_options(options.rolling_shutter, recording);
}

SceneOptions scene_options(const TrainOptions& options) {
  const FrameRange frames = parse_frame_range(options.frames);
  SceneOptions scene;
  scene.cameras = options.cameras;
  scene.first_frame = frames.first;
  scene.last_frame = frames.last;
  scene.frame_step = frames.step;
  scene.shown_only = true;
  scene.downscale = options.downscale;
  scene.holdout_every = options.holdout_every;
  scene.train_every = options.train_every;
  scene.undistort = options.undistort;
  scene.near_m = options.near_m;
  scene.far_m = options.far_m;
  if (options.background == "white") scene.background = Background::kWhite;
  if (options.background == "black" || options.background == "random")
    scene.background = Background::kBlack;
  scene.random_background =
      find_method(options.method)->random_background && scene.background != Background::kNone;
  return scene;
}

namespace {

/// Returns the bytes that an option allows of `whole` bytes.
std::uint64_t allowed_bytes(const char* option, const std::string& text, std::uint64_t whole,
                            const char* of) {
  constexpr double kGiB = 1024.0 * 1024 * 1024;
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const std::string unit(end, text.data() + text.size());
  const double bytes = unit == ""      ? value
                       : unit == "GiB" ? kGiB * value
                                       : 0.01 * value * static_cast<double>(whole);
  if (error != std::errc() || !(bytes >= 1 && bytes < 1e18) ||
      (unit != "" && unit != "GiB" && unit != "%"))
    throw UsageError(option, text,
                     std::string("must be bytes, or a number with GiB or % (of the ") + of +
                         "'s memory) behind it");
  return static_cast<std::uint64_t>(bytes);
}

}  // namespace

std::uint64_t allowed_memory(const TrainOptions& options, std::uint64_t machine) {
  return allowed_bytes("--memory", options.memory, machine, "machine");
}

std::uint64_t allowed_device_memory(const TrainOptions& options, std::uint64_t device) {
  return allowed_bytes("--gpu-memory", options.gpu_memory, device, "GPU");
}

std::int64_t total_steps(const TrainOptions& options, std::int64_t steps_per_epoch) {
  const std::int64_t steps = options.epochs * steps_per_epoch;
  return options.max_steps > 0 ? std::min(steps, options.max_steps) : steps;
}

nlohmann::json options_to_json(const TrainOptions& options) {
  nlohmann::json json = nlohmann::json::object();
  for (const TrainField& field : train_fields()) field.save(options, json);
  return json;
}

TrainOptions options_from_json(const nlohmann::json& json, const std::filesystem::path& file) {
  if (!json.is_object())
    throw InputError(file, "", json.type_name(), "must be an object with the options of a run");
  const std::vector<TrainField> fields = train_fields();
  for (const auto& [key, value] : json.items())
    if (key != kHyperparametersKey &&
        std::ranges::find(fields, key, &TrainField::name) == fields.end())
      throw InputError(file, key, value.dump().substr(0, 80), "unknown option");
  TrainOptions options;
  for (const TrainField& field : fields) {
    if (!json.contains(field.name) && field.hyperparameter.empty()) {
      if (contains({"recording", "method"}, field.name))
        throw InputError(file, field.name, "", "missing");
      continue;  // the run is older than the option
    }
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
