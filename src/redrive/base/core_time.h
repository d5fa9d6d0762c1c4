// SPDX-License-Identifier: Apache-2.0
// Measures the time that this process's work would take on an idle machine.
#pragma once

#include <chrono>

namespace redrive {

/// Measures work from its construction on.
class CoreTimer {
 public:
  CoreTimer();
  /// Seconds of one core for work that had `cores`: their time minus the time in which threads
  /// waited for a core that another program had (/proc/self/task/*/schedstat), and at least the
  /// processor time. Counts only processor time where Linux does not report waiting.
  double core_seconds(int cores) const;

 private:
  std::chrono::steady_clock::time_point start_;
  double cpu_s_, waited_s_;
};

}  // namespace redrive
