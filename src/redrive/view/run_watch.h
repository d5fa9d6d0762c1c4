// SPDX-License-Identifier: Apache-2.0
// Notices a newer checkpoint of a run that is shown, as of one that still trains, and a run that is
// gone.
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

/// What has become of the run since it was looked at.
struct RunNews {
  std::shared_ptr<const Run> run;  ///< run of a newer checkpoint; null: nothing new
  std::string problem;             ///< why the run cannot be opened any more; empty: it can
};

class RunWatch {
 public:
  /// A run or a divided run. Throws InputError as open_to_render.
  explicit RunWatch(const std::filesystem::path& root);

  std::shared_ptr<const Run> run() const { return run_; }  ///< as it was opened last

  /// Opens the run again where a checkpoint is another file than before. Throws nothing for a run
  /// that is gone or damaged; it is opened once it is back.
  RunNews look();

 private:
  /// Identifies the files: sums of inodes and sizes, time of the last writing. Nothing: there is
  /// none.
  using Stamp = std::optional<std::tuple<std::uint64_t, std::uint64_t, std::int64_t>>;
  Stamp stamp() const;
  /// Returns the checkpoints that belong to the run, of a divided one also its list of blocks
  /// and their brightness.
  std::vector<std::filesystem::path> files() const;

  RunPaths paths_;
  Stamp opened_;  ///< as of the last attempt
  std::shared_ptr<const Run> run_;
  std::string problem_;  ///< problem of the last attempt
};

}  // namespace redrive::view
