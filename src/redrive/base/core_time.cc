// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/core_time.h"

#include <algorithm>
#include <ctime>
#include <filesystem>
#include <fstream>

namespace redrive {
namespace {

double cpu_seconds() {
  timespec time{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Seconds in which the present threads could run and had no core; below 0: unknown.
double waited_seconds() {
  double sum = 0;
  std::error_code error;
  for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task", error)) {
    std::ifstream file(thread.path() / "schedstat");
    double ran_ns = 0, waited_ns = 0;
    if (!(file >> ran_ns >> waited_ns)) return -1;
    sum += 1e-9 * waited_ns;
  }
  return error ? -1 : sum;
}

}  // namespace

CoreTimer::CoreTimer()
    : start_(std::chrono::steady_clock::now()),
      cpu_s_(cpu_seconds()),
      waited_s_(waited_seconds()) {}

double CoreTimer::core_seconds(int cores) const {
  const double cpu_s = cpu_seconds() - cpu_s_, now_s = waited_seconds();
  if (waited_s_ < 0 || now_s < 0) return cpu_s;
  const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - start_;
  return std::max(cpu_s, cores * (wall.count() - std::max(0.0, now_s - waited_s_)));
}

}  // namespace redrive
