// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/run.h"

#include <unistd.h>

#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files.h"

namespace redrive {
namespace {

/// The checkpoint belongs to these options and this recording, or InputError.
void check_belongs(const Run& run) {
  const std::filesystem::path file = run.paths.checkpoint();
  const NerfModel& model = run.state.model;
  const auto same = [&](const char* field, auto in_checkpoint, auto expected) {
    if (in_checkpoint != expected)
      throw InputError(file, field, std::to_string(in_checkpoint),
                       "is " + std::to_string(expected) + " in " + run.paths.config().string());
  };
  same("width", model.config.width, run.options.width);
  same("samples", model.samples, run.options.samples);
  same("fine_samples", model.fine_samples, run.options.fine_samples);
  same("near_m", model.near_m, static_cast<float>(run.options.near_m));
  same("far_m", model.far_m, static_cast<float>(run.options.far_m));
  // Another compiler may round the last bit otherwise; another trajectory differs by far more.
  const UnitFromWorld &there = model.unit_from_world, &here = run.scene.unit_from_world;
  const double tolerance_m = 1e-5 / here.scale;
  bool equal = std::abs(there.scale / here.scale - 1) < 1e-5;
  for (int k = 0; k < 3; ++k) equal = equal && std::abs(there.center[k] - here.center[k]) < tolerance_m;
  if (!equal)
    throw InputError(file, "unit_from_world", std::to_string(there.scale),
                     "is " + std::to_string(here.scale) + " now: " + run.recording.root.string() +
                         " is no longer the recording that was trained on");
}

}  // namespace

void refuse_existing_run(const std::filesystem::path& root) {
  if (root.empty()) throw UsageError("--out", "", "must name a folder");
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::symlink_status(root, error);
  if (error && status.type() == std::filesystem::file_type::none)
    throw UsageError("--out", root.string(), error.message());
  if (std::filesystem::exists(status))
    throw UsageError("--out", root.string(), "exists already; nothing is overwritten, choose another name");
}

RunPaths create_run(const std::filesystem::path& out, const TrainOptions& options) {
  refuse_existing_run(out);
  const std::filesystem::path root = out.has_filename() ? out : out.parent_path();  // "run/" is run
  std::error_code error;
  if (root.has_parent_path()) std::filesystem::create_directories(root.parent_path(), error);
  // Made beside it under another name and then renamed: a kill in between must not leave a folder that train refuses
  // because it exists and resume because it holds no run.
  std::filesystem::path temporary = root;
  temporary += ".tmp-" + std::to_string(::getpid());
  if (error || !std::filesystem::create_directory(temporary, error))
    throw IoError(temporary, error ? error.message() : "exists already");
  try {
    write_config({temporary}, options);
    std::filesystem::rename(temporary, root, error);
    if (error) throw IoError(root, error.message());
  } catch (...) {
    std::filesystem::remove_all(temporary, error);
    throw;
  }
  return {root};
}

void write_config(const RunPaths& paths, const TrainOptions& options) {
  write_file(paths.config(), options_to_json(options).dump(2) + "\n");
}

TrainState first_state(const TrainOptions& options, const Scene& scene) {
  NerfConfig config;
  config.width = options.width;
  return initial_state(config, options.samples, options.fine_samples, scene, options.seed);
}

Run open_run(const std::filesystem::path& root, bool fresh_if_untrained) {
  Run run;
  run.paths.root = root;
  std::error_code error;
  if (!std::filesystem::is_directory(root, error)) throw InputError(root, "", "", "no such run folder");
  run.options = options_from_json(read_json(run.paths.config()), run.paths.config());
  run.recording = open_recording(run.options);
  run.scene = make_scene(run.recording, scene_options(run.options));
  const auto there = std::filesystem::status(run.paths.checkpoint(), error).type();
  if (fresh_if_untrained && there == std::filesystem::file_type::not_found) {
    run.state = first_state(run.options, run.scene);
  } else {
    run.state = load_checkpoint(run.paths.checkpoint());
    check_belongs(run);
  }
  return run;
}

}  // namespace redrive
