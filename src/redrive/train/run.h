// SPDX-License-Identifier: Apache-2.0
// A run folder: config.json (resolved options), metrics.jsonl, checkpoint.safetensors, figures/, report.html.
// Nothing is written outside it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/train/model.h"
#include "redrive/train/options.h"

namespace redrive {

struct RunPaths {
  std::filesystem::path root;
  std::filesystem::path config() const { return root / "config.json"; }
  std::filesystem::path metrics() const { return root / "metrics.jsonl"; }
  std::filesystem::path checkpoint() const { return root / "checkpoint.safetensors"; }
  std::filesystem::path figures() const { return root / "figures"; }
  std::filesystem::path report() const { return root / "report.html"; }
};

/// UsageError if `root` exists, whatever is in it.
void refuse_existing_run(const std::filesystem::path& root);
/// Makes the folder and writes config.json; refuses an existing one.
RunPaths create_run(const std::filesystem::path& root, const TrainOptions& options);
void write_config(const RunPaths& paths, const TrainOptions& options);

/// A trained run, opened for eval, render, figures or resume: options, recording, scene and state belong together.
struct Run {
  RunPaths paths;
  TrainOptions options;
  Recording recording;
  Scene scene;
  TrainState state;
};
/// InputError if a file is missing or they do not belong together. `fresh_if_untrained`: a run that was killed before its
/// first checkpoint opens with the state it would have started from (for resume), else that is an error.
Run open_run(const std::filesystem::path& root, bool fresh_if_untrained = false);
/// The state a run starts from.
TrainState first_state(const TrainOptions& options, const Scene& scene);

/// One line of metrics.jsonl.
struct MetricsRow {
  std::int64_t step = 0;
  double seconds = 0, loss = 0, psnr_db = 0, learning_rate = 0, rays_per_s = 0;
  int epoch = 0;
};
/// The rows of the start that is in use: what came before a restart is left out. A last line that a kill cut short is
/// ignored; empty if there is no file yet. InputError names the line that cannot be read.
std::vector<MetricsRow> read_metrics(const RunPaths& paths);

void append_metrics(const RunPaths& paths, const MetricsRow& row);
/// {"event": "restart", ...}: from here on the rows are of start number `restarts`.
void append_restart(const RunPaths& paths, std::int64_t step, int restarts, std::uint64_t seed,
                    const std::string& reason);
/// Drops what was written after the checkpoint that is resumed from.
void cut_metrics(const RunPaths& paths, std::int64_t step, int restarts);

}  // namespace redrive
