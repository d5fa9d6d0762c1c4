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

/// Makes the folder and writes config.json. UsageError if it exists (whatever is in it).
RunPaths create_run(const std::filesystem::path& root, const TrainOptions& options);

/// A trained run, opened for eval, render, figures or resume: options, recording, scene and state belong together.
struct Run {
  RunPaths paths;
  TrainOptions options;
  Recording recording;
  Scene scene;
  TrainState state;
};
Run open_run(const std::filesystem::path& root);

/// One line of metrics.jsonl.
struct MetricsRow {
  std::int64_t step = 0;
  double seconds = 0, loss = 0, psnr_db = 0, learning_rate = 0, rays_per_s = 0;
  int epoch = 0;
};
std::vector<MetricsRow> read_metrics(const RunPaths& paths);

}  // namespace redrive
