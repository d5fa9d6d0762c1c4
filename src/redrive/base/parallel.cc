// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/parallel.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <limits>
#include <mutex>
#include <utility>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/parallel_tbb.h"
#include "redrive/base/processes/interruption.h"

namespace redrive {
namespace {

/// One call of ThreadPool::run. The two atomics repeat, in code that ThreadSanitizer sees, the
/// ordering that oneTBB (not instrumented) guarantees: earlier writes of the caller are visible to
/// every chunk, and writes of the chunks to the caller. Chunks are not ordered with each other, so
/// their races are still found.
struct Job {
  const ThreadPool* pool;
  const std::function<void(int)>* body;
  std::atomic<bool> started{false};
  std::atomic<int> done{0};
  std::mutex mutex;
  int failed_chunk = std::numeric_limits<int>::max();  ///< the lowest one, so that the error does
                                                       ///< not depend on timing
  std::exception_ptr error;
};

/// The pool whose chunk this thread runs, the innermost one; null outside of all.
thread_local const ThreadPool* running_pool = nullptr;

void run_chunk(void* context, int chunk) {
  Job& job = *static_cast<Job*>(context);
  (void)job.started.load(std::memory_order_acquire);
  const ThreadPool* const outer = std::exchange(running_pool, job.pool);
  try {
    check_interruption();
    (*job.body)(chunk);
  } catch (...) {
    const std::lock_guard lock(job.mutex);
    if (chunk < job.failed_chunk) {
      job.failed_chunk = chunk;
      job.error = std::current_exception();
    }
  }
  running_pool = outer;
  job.done.fetch_add(1, std::memory_order_release);
}

}  // namespace

struct ThreadPool::Impl {
  int threads;
  TbbArena arena;  ///< null: everything runs in the caller
};

ThreadPool::ThreadPool(int threads) {
  REDRIVE_CHECK_OP(threads, >=, 1);
  // More workers than processors would only take turns (and oneTBB complains); results depend on
  // chunks, not on this.
  const int concurrency = std::min(threads, hardware_threads());
  impl_ = std::make_unique<Impl>(
      Impl{threads, concurrency > 1 ? make_tbb_arena(concurrency) : nullptr});
}

ThreadPool::~ThreadPool() = default;

int ThreadPool::threads() const { return impl_->threads; }

void ThreadPool::run(int chunks, const std::function<void(int chunk)>& body) {
  REDRIVE_CHECK(running_pool != this);
  Job job{this, &body};
  job.started.store(true, std::memory_order_release);
  if (!impl_->arena || chunks == 1) {
    for (int chunk = 0; chunk < chunks; ++chunk) run_chunk(&job, chunk);
  } else if (chunks > 1) {
    tbb_run(*impl_->arena, chunks, run_chunk, &job);
  }
  REDRIVE_CHECK_OP(job.done.load(std::memory_order_acquire), ==, std::max(chunks, 0));
  if (job.error) std::rethrow_exception(job.error);
}

void ThreadPool::run_ranges(std::size_t size, std::size_t grain,
                            const std::function<void(std::size_t begin, std::size_t end)>& body) {
  REDRIVE_CHECK_OP(grain, >=, std::size_t{1});
  const std::size_t ranges = size / grain + (size % grain != 0);
  REDRIVE_CHECK_OP(ranges, <=, std::size_t{std::numeric_limits<int>::max()});
  run(static_cast<int>(ranges), [&](int range) {
    const std::size_t begin = static_cast<std::size_t>(range) * grain;
    body(begin, begin + std::min(grain, size - begin));
  });
}

}  // namespace redrive
