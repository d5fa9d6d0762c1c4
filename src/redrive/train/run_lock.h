// SPDX-License-Identifier: Apache-2.0
// One process at a time trains a run: two would write the same checkpoint and metrics.
#pragma once

#include <filesystem>

namespace redrive {

/// Holds flock(LOCK_EX) on the run's folder itself: no lock file, and nothing is left behind by a
/// kill.
class RunLock {
 public:
  /// UsageError if another process trains this run, InputError if there is no such folder.
  explicit RunLock(const std::filesystem::path& root);
  ~RunLock();
  RunLock(const RunLock&) = delete;
  RunLock& operator=(const RunLock&) = delete;

 private:
  int fd_;
};

}  // namespace redrive
