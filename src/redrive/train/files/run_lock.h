// SPDX-License-Identifier: Apache-2.0
// Lock of a run folder: two processes must not write the same checkpoint and metrics.
#pragma once

#include <filesystem>

namespace redrive {

/// Holds flock(LOCK_EX) on the run's folder itself, so a kill leaves no lock file behind.
class RunLock {
 public:
  /// Throws UsageError if another process trains this run, InputError if there is no such folder.
  explicit RunLock(const std::filesystem::path& root);
  ~RunLock();
  RunLock(const RunLock&) = delete;
  RunLock& operator=(const RunLock&) = delete;

 private:
  int fd_;
};

}  // namespace redrive
