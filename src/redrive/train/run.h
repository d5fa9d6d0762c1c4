// SPDX-License-Identifier: Apache-2.0
// A run folder: config.json (resolved options), masks/, poses/ (from --poses and --align),
// metrics.jsonl, checkpoint.safetensors, figures/, report.html; in scene bundles recording.json.
// Nothing is written outside it.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/kernels/backend.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/train/files/blocks.h"
#include "redrive/train/files/options.h"
#include "redrive/train/files/state.h"

namespace redrive {

struct RunPaths {
  std::filesystem::path root;
  std::filesystem::path config() const { return root / "config.json"; }
  std::filesystem::path masks() const {
    return root / "masks";
  }  ///< perception/masks.h write_masks
  std::filesystem::path poses() const {
    return root / "poses";
  }  ///< recording/formats/pose_files.h, where has_external_poses
  std::filesystem::path recording() const {
    return root / "recording.json";
  }  ///< recording/formats/recording_json.h, where the run moved without its recording
  std::filesystem::path metrics() const { return root / "metrics.jsonl"; }
  std::filesystem::path checkpoint() const { return root / "checkpoint.safetensors"; }
  std::filesystem::path figures() const { return root / "figures"; }
  std::filesystem::path report() const { return root / "report.html"; }
};

/// Throws InputError unless `root` is a folder with a config.json; says what the folder is instead,
/// and which one may have been meant.
void require_run(const std::filesystem::path& root);

/// Throws UsageError if `root` is empty or exists.
void check_run_is_new(const std::filesystem::path& root);
/// Makes the folder with config.json and the files that `fill` writes, all or nothing. Throws
/// UsageError if it exists.
RunPaths create_run(const std::filesystem::path& root, const TrainOptions& options,
                    const std::function<void(const RunPaths&)>& fill = {},
                    Trainee* model = nullptr);
/// Writes config.json, with the resolved hyperparameters of `model` unless it is null.
void write_config(const RunPaths& paths, const TrainOptions& options, Trainee* model = nullptr);

/// A trained run, opened for eval, render, figures or resume: options, recording, scene and state
/// belong together.
struct Run {
  RunPaths paths;
  TrainOptions options;
  Recording recording;
  Scene scene;
  TrainState state;           ///< a drive in blocks has only its steps and seconds
  MovingObjects moving;       ///< annotated ones and found ones (load_actors)
  std::vector<Block> blocks;  ///< blocks of the drive; empty: one run
  std::unique_ptr<const Field> field_of_blocks;  ///< their field (render/open_to_render.h)

  /// Returns what renders; null: there is only the recording.
  const Field* field() const { return field_of_blocks ? field_of_blocks.get() : state.model.get(); }
};
/// Opens a run with the corrections of its poses applied to the scene. to_resume: without them; a
/// run that was killed before its first checkpoint then opens with the initial state.
/// `max_damaged` takes the place of that option. Throws InputError if a file is missing or the
/// files do not belong together.
Run open_run(const std::filesystem::path& root, bool to_resume = false,
             std::optional<double> max_damaged = {});

/// Sets RecordedLidar::gain, beam_gains and blind of the recording's LiDARs; no gains leave them.
/// `file`: where the gains are from. InputError where they are not as many as the LiDARs.
void set_gains(const std::vector<LidarGains>& gains, const std::filesystem::path& file,
               Recording* recording);

/// Sets run->moving to the annotated objects that move and to `found` ones
/// (perception/find_moving.h). If the model draws objects, sets run->scene.actors to those with
/// boxes at two or more times that exist at a frame of the scene. InputError as the readers of
/// boxes.
void load_actors(Run* run, const std::vector<MovingObject>& found);
/// The same with the run's masks/moving.json, or without it with --masks none. open_run() calls it.
/// InputError as read_moving_file, and if the masks of a block (train/files/blocks.h) did not come
/// with it.
void load_actors(Run* run);
/// Makes the backend for a method. UsageError: as kernels::make_backend, or it does not compute the
/// method.
std::unique_ptr<kernels::Backend> make_backend(kernels::BackendChoice choice,
                                               const std::string& method);
/// Returns the backend that the options choose. UsageError.
std::unique_ptr<kernels::Backend> make_backend(const TrainOptions& options);
/// Resolves options of a new run that depend on run->recording (resolve_cameras, resolve_bounds),
/// and makes its scene. `given`: names of the options that were given.
void make_run_scene(Run* run, const std::vector<std::string>& given);
/// Returns the model of options and scene, without parameters.
std::unique_ptr<Trainee> make_run_model(const TrainOptions& options, const Scene& scene);
/// Returns the state that a run starts from.
TrainState make_initial_state(const TrainOptions& options, const Scene& scene);

/// One line of metrics.jsonl.
struct MetricsRow {
  std::int64_t step = 0;
  double seconds = 0, loss = 0, psnr_db = 0, learning_rate = 0, rays_per_s = 0;
  int epoch = 0;
  std::vector<std::pair<std::string, double>> losses = {};  ///< terms of the loss by name
  double image_wait_s = 0;  ///< time that steps waited for images since the row before
};
/// Returns the rows of the current start, without rows before a restart and rows that a roll-back
/// undid; empty if there is no file yet. Ignores a truncated last line. Throws InputError naming
/// the line that cannot be read.
std::vector<MetricsRow> read_metrics(const RunPaths& paths);
/// Parses the rows from the bytes of `file`.
std::vector<MetricsRow> parse_metrics(std::string_view bytes, const std::filesystem::path& file);

void append_metrics(const RunPaths& paths, const MetricsRow& row);
/// Appends {"event": "restart", ...}: later rows belong to start number `restarts`.
void append_restart(const RunPaths& paths, std::int64_t step, int restarts, std::uint64_t seed,
                    const std::string& reason);
/// Appends {"event": "rollback", ...}: later rows continue from `to_step`, after `rollbacks` of
/// them in this start.
void append_rollback(const RunPaths& paths, std::int64_t step, std::int64_t to_step, int rollbacks,
                     double rate_factor, const std::string& reason);
/// Position of a state among the rows: ordered by start, roll-back and step.
struct MetricsPosition {
  int restarts = 0, rollbacks = 0;
  std::int64_t step = 0;
};
/// Removes the rows after the checkpoint that is resumed from, and everything from the first
/// unreadable line on: a power cut may leave zeros or half a line at the end.
void truncate_metrics(const RunPaths& paths, const MetricsPosition& position);
/// Returns the part of `bytes` that truncate_metrics keeps.
std::string truncated_metrics(std::string_view bytes, const MetricsPosition& position);
/// Flushes the rows to disk. Call before each checkpoint, so that after a power cut no checkpoint
/// is newer than its rows.
void sync_metrics(const RunPaths& paths);

}  // namespace redrive
