// SPDX-License-Identifier: Apache-2.0
// A thread pool that takes chunks of work from a queue. Which thread runs a chunk varies, but the
// work of a chunk does not: sums kept per chunk and added in chunk order are bit-equal.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

namespace redrive {

class ThreadPool {
 public:
  explicit ThreadPool(int threads);  ///< threads >= 1, including the caller's
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int threads() const;

  /// Runs body(chunk) for every chunk in [0, chunks) and returns when all are done. The
  /// exception of the lowest chunk that throws is rethrown when all have ended. Chunks that begin
  /// after Ctrl-C throw Interrupted (base/processes/interruption.h). A chunk must not run others on
  /// its own pool.
  void run(int chunks, const std::function<void(int chunk)>& body);

  /// Splits [0, size) into ranges of `grain` and runs body(begin, end) on each.
  void run_ranges(std::size_t size, std::size_t grain,
                  const std::function<void(std::size_t begin, std::size_t end)>& body);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace redrive
