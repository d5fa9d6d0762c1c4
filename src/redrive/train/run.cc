// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/run.h"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/unfinished.h"
#include "redrive/base/progress.h"
#include "redrive/model/method.h"
#include "redrive/perception/moving_file.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/folder_kind.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/recording/formats/recording_json.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

/// Whether a number equals `text` up to its last bits, which depend on the compiler. Values of
/// another trajectory or option differ by far more.
bool agree(const HyperparameterValue& value, const std::string& text) {
  if (value.is_list || value.whole) return value.text == text;
  const double a = std::stod(value.text), b = std::stod(text);
  return std::abs(a - b) <= 1e-5 * std::max({0.1, std::abs(a), std::abs(b)});
}

/// Returns all hyperparameters of a run: the model's and pose refinement's.
std::vector<HyperparameterValue> all_hyperparameters(Trainee& model, const TrainOptions& options) {
  std::vector<HyperparameterValue> all = hyperparameter_values(model);
  PoseRefinement refinement = pose_refinement(options);
  for (HyperparameterValue& value : hyperparameter_values(refinement))
    all.push_back(std::move(value));
  return all;
}

/// Throws InputError if the hyperparameters of config.json differ from what options and recording
/// give.
void check_shown_hyperparameters(const Run& run, const nlohmann::json& config) {
  if (!config.contains(kHyperparametersKey)) return;
  const nlohmann::json& shown = config.at(kHyperparametersKey);
  const auto expected = make_run_model(run.options, run.scene);
  for (const HyperparameterValue& value : all_hyperparameters(*expected, run.options)) {
    const std::string& name = value.what.name;
    const nlohmann::json number =
        shown.is_object() && shown.contains(name) ? shown.at(name) : nullptr;
    const bool agrees = value.is_list ? number == hyperparameter_json(value)
                                      : number.is_number() && agree(value, number.dump());
    if (!agrees)
      throw InputError(
          run.paths.config(), std::string(kHyperparametersKey) + "." + name,
          number.dump().substr(0, 80),
          "is " + value.text + " by the options and the recording; options and --set change it");
  }
}

/// Throws InputError if the masks of a block (train/files/blocks.h) did not come with it: without a
/// file nothing is masked.
void check_link(const std::filesystem::path& masks) {
  std::error_code error;
  if (std::filesystem::is_symlink(masks, error) && !std::filesystem::exists(masks, error))
    throw InputError(masks, "", "",
                     "links to a folder that is not there; cp -rL copies a block with its masks");
}

/// Throws InputError unless the checkpoint belongs to these options and this recording.
void check_belongs(const Run& run) {
  const std::filesystem::path file = run.paths.checkpoint();
  const std::unique_ptr<Trainee> expected = make_run_model(run.options, run.scene);
  if (std::string(run.state.model->method()) != expected->method())
    throw InputError(
        file, "method", run.state.model->method(),
        std::string("is ") + expected->method() + " in " + run.paths.config().string());
  const PoseCorrections& poses = run.state.poses.corrections;
  if (run.state.poses.refines() && (poses.frames != static_cast<int>(run.scene.frames.size()) ||
                                    poses.cameras != static_cast<int>(run.scene.rig.size())))
    throw InputError(
        file, "poses",
        std::to_string(poses.frames) + " frames, " + std::to_string(poses.cameras) + " cameras",
        run.recording.root.string() + " has " + std::to_string(run.scene.frames.size()) + " and " +
            std::to_string(run.scene.rig.size()) +
            " of the run: it is no longer the recording that was trained on");
  const auto found = hyperparameter_values(*run.state.model),
             here = hyperparameter_values(*expected);
  for (std::size_t i = 0; i < here.size(); ++i)
    if (!agree(found[i], here[i].text))
      throw InputError(file, here[i].what.name, found[i].text,
                       "is " + here[i].text + " now: " + run.recording.root.string() +
                           " is no longer the recording that was trained on, or " +
                           run.paths.config().string() + " of another run");
}

}  // namespace

void require_run(const std::filesystem::path& root) {
  if (file_bytes(RunPaths{root}.config())) return;
  std::error_code error;
  const std::string is = describe_folder(root), hint = is.empty() ? did_you_mean(root) : "";
  const bool is_folder = std::filesystem::is_directory(root, error);
  throw InputError(root, "", "",
                   (!is.empty() ? "is no run but " + is + "; redrive train makes a run of one"
                    : is_folder ? "is no run, it has no config.json"
                                : "no such run folder") +
                       (hint.empty() ? "" : "; " + hint));
}

void check_run_is_new(const std::filesystem::path& root) {
  if (root.empty()) throw UsageError("--out", "", "must name a folder");
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::symlink_status(root, error);
  if (error && status.type() == std::filesystem::file_type::none)
    throw UsageError("--out", root.string(), error.message());
  if (std::filesystem::exists(status))
    throw UsageError("--out", root.string(),
                     "exists already; nothing is overwritten, choose another name");
}

RunPaths create_run(const std::filesystem::path& out, const TrainOptions& options,
                    const std::function<void(const RunPaths&)>& fill, Trainee* model) {
  check_run_is_new(out);
  // A kill in between must not leave a folder that train rejects because it exists and resume
  // rejects because it holds no run.
  write_folder(out, /*replace=*/false, [&](const std::filesystem::path& made) {
    write_config({made}, options, model);
    if (fill) fill({made});
  });
  return {out.has_filename() ? out : out.parent_path()};  // "run/" is run
}

void write_config(const RunPaths& paths, const TrainOptions& options, Trainee* model) {
  nlohmann::json json = options_to_json(options);
  if (model)
    for (const HyperparameterValue& value : all_hyperparameters(*model, options))
      json[kHyperparametersKey][value.what.name] = hyperparameter_json(value);
  write_file(paths.config(), json.dump(2) + "\n");
}

std::unique_ptr<kernels::Backend> make_backend(kernels::BackendChoice choice,
                                               const std::string& method) {
  choice.marches_rays = !find_method(method)->rasterises;
  std::unique_ptr<kernels::Backend> backend = kernels::make_backend(choice);
  const bool named = !choice.device.empty();
  if (choice.marches_rays && !backend->marches_rays())
    throw UsageError(named ? "--device" : "--backend", named ? choice.device : choice.name,
                     "does not compute method " + method + ", which processors do: --backend cpu");
  return backend;
}

std::unique_ptr<kernels::Backend> make_backend(const TrainOptions& options) {
  return make_backend({options.backend, options.isa, options.threads, options.device},
                      options.method);
}

void make_run_scene(Run* run, const std::vector<std::string>& given) {
  resolve_cameras(&run->options, &run->recording);
  resolve_bounds(&run->options, given, run->recording);
  run->scene = make_scene(run->recording, scene_options(run->options));
}

std::unique_ptr<Trainee> make_run_model(const TrainOptions& options, const Scene& scene) {
  auto model = make_model(options.method);
  model->configure(scene);
  apply_hyperparameters(options, model.get());
  return model;
}

TrainState make_initial_state(const TrainOptions& options, const Scene& scene) {
  TrainState state = initial_state(make_run_model(options, scene), options.seed);
  if (refines_poses(options, scene)) state.poses = PoseState(scene);
  return state;
}

Run open_run(const std::filesystem::path& root, bool to_resume, std::optional<double> max_damaged) {
  Run run;
  run.paths.root = root;
  std::error_code error;
  require_run(root);
  const Progress progress("opening the run");
  const nlohmann::json config = read_json(run.paths.config());
  run.options = options_from_json(config, run.paths.config());
  if (max_damaged) run.options.max_damaged = *max_damaged;
  if (file_bytes(run.paths.recording())) {
    run.recording = read_recording_json(run.paths.recording());
  } else {
    run.recording = open_recording(run.options);
    if (has_external_poses(run.options))
      use_external_poses(read_pose_files(run.recording, run.paths.poses()), run.paths.poses(),
                         run.options, &run.recording);
  }
  run.scene = make_scene(run.recording, scene_options(run.options));
  const auto there = std::filesystem::status(run.paths.checkpoint(), error).type();
  if (to_resume && there == std::filesystem::file_type::not_found) {
    run.state = make_initial_state(run.options, run.scene);
    load_actors(&run);
  } else {
    if (!to_resume) check_rendering_memory(run);
    run.state = load_checkpoint(run.paths.checkpoint());
    check_belongs(run);
    set_gains(run.state.lidar_gains, run.paths.checkpoint(), &run.recording);
    check_shown_hyperparameters(run, config);
    load_actors(&run);  // in the poses that training began with, as training did
    if (run.state.step > 0 || !to_resume)
      run.state.model->check_actors(run.recording.root, moving_file(run.paths.masks()),
                                    run.scene.actors);
    if (!to_resume) run.state.model->correct_actors(&run.scene.actors);
    if (!to_resume && run.state.poses.refines()) run.scene.correct(run.state.poses.corrections);
    if (!to_resume) run.state.model->freeze();
  }
  return run;
}

void set_gains(const std::vector<LidarGains>& gains, const std::filesystem::path& file,
               Recording* recording) {
  std::vector<RecordedLidar>& lidars = recording->lidars;
  if (!gains.empty() && gains.size() != lidars.size())
    throw InputError(file, "lidar_gains", std::to_string(gains.size()),
                     recording->root.string() + " has " + counted(lidars.size(), "LiDAR") +
                         ": it is no longer the recording that was trained on");
  for (std::size_t k = 0; k < gains.size(); ++k) {
    lidars[k].gain = double(gains[k].gain);
    lidars[k].beam_gains = gains[k].beams;
    lidars[k].blind = gains[k].blind;
  }
}

void load_actors(Run* run, const std::vector<MovingObject>& found) {
  run->moving = read_moving_objects(run->recording, run->scene).with(found);
  run->scene.actors.clear();
  if (!run->field()->draws_actors()) return;
  for (const MovingObject& object : run->moving.objects())
    if (object.keys.size() >= 2 && std::ranges::any_of(run->scene.frames, [&](const Frame& frame) {
          return object.world_from_box(frame.t_ns).has_value();
        }))
      run->scene.actors.push_back(object);
}

void load_actors(Run* run) {
  if (run->options.masks == "none") return load_actors(run, {});
  check_link(run->paths.masks());
  load_actors(run, read_moving_file(moving_file(run->paths.masks())));
}

}  // namespace redrive
