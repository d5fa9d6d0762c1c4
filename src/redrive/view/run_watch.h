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

#include "redrive/train/run.h"

namespace redrive::view {

/// What has become of the run since it was looked at.
struct RunNews {
  std::shared_ptr<const Run> run;  ///< of a newer checkpoint; null: nothing new
  std::string problem;             ///< why the run cannot be opened any more; empty: it can
};

class RunWatch {
 public:
  /// Throws InputError as open_run.
  explicit RunWatch(const std::filesystem::path& root);

  std::shared_ptr<const Run> run() const { return run_; }  ///< as it was opened last

  /// Opens the run again where its checkpoint is another file than before. Throws nothing for a run
  /// that is gone or damaged; it is opened once it is back.
  RunNews look();

 private:
  /// Identifies the file of the checkpoint: inode, size, time of writing. Nothing: there is none.
  using Stamp = std::optional<std::tuple<std::uint64_t, std::uint64_t, std::int64_t>>;
  Stamp stamp() const;

  RunPaths paths_;
  Stamp opened_;  ///< as of the last attempt
  std::shared_ptr<const Run> run_;
  std::string problem_;  ///< of the last attempt
};

}  // namespace redrive::view
