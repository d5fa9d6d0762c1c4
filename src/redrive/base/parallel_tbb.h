// SPDX-License-Identifier: Apache-2.0
// oneTBB behind two plain functions. parallel_tbb.cc is never instrumented by ThreadSanitizer:
// libtbb is not either, and its header-inlined task objects would look like races.
#pragma once

#include <memory>

namespace tbb::detail::d1 {
class task_arena;
}

namespace redrive {

struct TbbArenaDelete {
  void operator()(tbb::detail::d1::task_arena* arena) const;
};
using TbbArena = std::unique_ptr<tbb::detail::d1::task_arena, TbbArenaDelete>;

TbbArena make_tbb_arena(int threads);

/// Runs chunk(context, i) for i in [0, chunks) on the arena's threads, the caller's included.
/// `chunk` must not throw.
void tbb_run(tbb::detail::d1::task_arena& arena, int chunks,
             void (*chunk)(void* context, int index), void* context);

}  // namespace redrive
