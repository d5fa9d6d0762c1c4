// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/run.h"

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
  if (std::filesystem::exists(std::filesystem::symlink_status(root, error)))
    throw UsageError("--out", root.string(), "exists already; nothing is overwritten, choose another name");
}

RunPaths create_run(const std::filesystem::path& root, const TrainOptions& options) {
  refuse_existing_run(root);
  std::error_code error;
  if (root.has_parent_path()) std::filesystem::create_directories(root.parent_path(), error);
  if (error || !std::filesystem::create_directory(root, error))
    throw IoError(root, error ? error.message() : "exists already");
  const RunPaths paths{root};
  try {
    write_config(paths, options);
  } catch (...) {
    std::filesystem::remove(root, error);  // empty: the next try must not meet it
    throw;
  }
  return paths;
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
  if (!std::filesystem::is_directory(root)) throw InputError(root, "", "", "no such run folder");
  run.options = options_from_json(read_json(run.paths.config()), run.paths.config());
  run.recording = open_recording(run.options.recording);
  run.scene = make_scene(run.recording, scene_options(run.options));
  if (fresh_if_untrained && !std::filesystem::exists(run.paths.checkpoint())) {
    run.state = first_state(run.options, run.scene);
  } else {
    run.state = load_checkpoint(run.paths.checkpoint());
    check_belongs(run);
  }
  return run;
}

}  // namespace redrive
