// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/parallel_tbb.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/partitioner.h>
#include <tbb/task_arena.h>

namespace redrive {

void TbbArenaDelete::operator()(tbb::task_arena* arena) const { delete arena; }

TbbArena make_tbb_arena(int threads) { return TbbArena(new tbb::task_arena(threads)); }

void tbb_run(tbb::task_arena& arena, int chunks, void (*chunk)(void* context, int index),
             void* context) {
  arena.execute([=] {
    // Grain 1: a thread that lost its core to somebody else delays one chunk, not its share of all
    // of them.
    tbb::parallel_for(
        tbb::blocked_range<int>(0, chunks, 1),
        [=](const tbb::blocked_range<int>& range) {
          for (int i = range.begin(); i < range.end(); ++i) chunk(context, i);
        },
        tbb::simple_partitioner());
  });
}

}  // namespace redrive
