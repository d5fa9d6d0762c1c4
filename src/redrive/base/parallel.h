// SPDX-License-Identifier: Apache-2.0
// Threads: a pool of a fixed number of workers that takes lanes from a queue. Which worker runs a
// lane is open, what a lane does is fixed: sums kept per lane and reduced in lane order are
// bit-equal from run to run.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

namespace redrive {

class ThreadPool {
 public:
  explicit ThreadPool(int threads);  ///< threads >= 1, the caller's included
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int threads() const;

  /// Runs body(lane) for every lane in [0, lanes) and returns when all are done. An exception of a
  /// body is rethrown here after the others have ended. Not reentrant.
  void run(int lanes, const std::function<void(int lane)>& body);

  /// Cuts [0, size) into ranges of `grain` and runs body(begin, end) on each.
  void run_ranges(std::size_t size, std::size_t grain,
                  const std::function<void(std::size_t begin, std::size_t end)>& body);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace redrive
