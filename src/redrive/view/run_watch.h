// SPDX-License-Identifier: Apache-2.0
// Notices newer checkpoints of a shown run, for example one in training, and a run that is gone.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "redrive/train/run.h"

namespace redrive::view {

/// Changes of the run since the last look.
struct RunNews {
  std::shared_ptr<const Run> run;  ///< run of a newer checkpoint; null: nothing new
  std::string problem;             ///< reason why the run cannot be opened any more; empty: it can
};

class RunWatch {
 public:
  /// A run or a divided run. Throws InputError as open_to_render.
  explicit RunWatch(const std::filesystem::path& root, std::optional<double> max_damaged = {});

  std::shared_ptr<const Run> run() const { return run_; }  ///< the run as it was opened last

  /// Opens the run again where a checkpoint is another file than before. Throws nothing for a run
  /// that is gone or damaged; opens it once it is back.
  RunNews look();

 private:
  /// Identifies the files: sums of inodes and sizes, time of the last writing. Nothing: there is
  /// none.
  using Stamp = std::optional<std::tuple<std::uint64_t, std::uint64_t, std::int64_t>>;
  Stamp stamp() const;
  /// Returns the checkpoints of the run; for a divided one also its list of blocks and their
  /// brightness.
  std::vector<std::filesystem::path> files() const;

  RunPaths paths_;
  std::optional<double> max_damaged_;  ///< open_to_render
  Stamp opened_;                       ///< at the last attempt
  std::shared_ptr<const Run> run_;
  std::string problem_;  ///< problem of the last attempt
};

}  // namespace redrive::view
