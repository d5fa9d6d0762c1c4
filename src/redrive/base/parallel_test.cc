// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/parallel.h"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/parallel_sort.h"

namespace redrive {
namespace {

TEST(ThreadPool, RunsEveryChunkOnce) {
  for (const int threads : {1, 2, 4}) {
    ThreadPool pool(threads);
    EXPECT_EQ(pool.threads(), threads);
    for (const int chunks : {0, 1, 2, 7, 1000}) {
      // Plain ints, so that ThreadSanitizer checks whether the caller may read the chunks' writes.
      std::vector<int> count(chunks, 0);
      pool.run(chunks, [&](int chunk) { ++count[chunk]; });
      EXPECT_EQ(count, std::vector<int>(chunks, 1));
    }
  }
}

TEST(SortInParallel, SortsAnyNumber) {
  ThreadPool pool(3);
  for (const std::size_t n : {0, 1, 8192, 8193, 100'000}) {
    std::vector<std::uint32_t> values(n);
    for (std::size_t i = 0; i < n; ++i) values[i] = static_cast<std::uint32_t>(i) * 2654435761u;
    std::vector<std::uint32_t> expected = values;
    std::ranges::sort(expected);
    sort_in_parallel(&values, pool);
    EXPECT_EQ(values, expected) << n;
  }
}

TEST(ThreadPool, SuccessiveRunsSeeEachOthersWork) {
  ThreadPool pool(2);
  std::vector<long> value(64, 0);
  for (int round = 1; round <= 200; ++round) {
    pool.run(64, [&](int chunk) { value[chunk] += round; });
    // Another mapping of chunks to data: chunk i reads and writes what chunk 63 - i wrote.
    pool.run(64, [&](int chunk) { value[63 - chunk] += round; });
  }
  EXPECT_EQ(value, std::vector<long>(64, 2 * 200 * 201 / 2));
}

TEST(ThreadPool, OneThreadRunsChunksInOrder) {
  ThreadPool pool(1);
  std::vector<int> order;
  const std::thread::id caller = std::this_thread::get_id();
  pool.run(5, [&](int chunk) {
    EXPECT_EQ(std::this_thread::get_id(), caller);
    order.push_back(chunk);
  });
  EXPECT_EQ(order, (std::vector<int>{0, 1, 2, 3, 4}));
}

TEST(ThreadPool, RethrowsTheLowestChunksExceptionAfterAllHaveEnded) {
  for (const int threads : {1, 2}) {
    ThreadPool pool(threads);
    std::atomic<int> ended = 0;
    try {
      pool.run(100, [&](int chunk) {
        ++ended;
        if (chunk % 10 == 3) throw std::runtime_error(std::to_string(chunk));
      });
      FAIL() << "no exception";
    } catch (const std::runtime_error& error) {
      EXPECT_STREQ(error.what(), "3");
    }
    EXPECT_EQ(ended, 100);
    pool.run(1, [&](int) { ++ended; });  // and the pool still works
    EXPECT_EQ(ended, 101);
  }
}

TEST(ThreadPool, RangesCoverEverythingOnce) {
  ThreadPool pool(2);
  for (const std::size_t size : {0u, 1u, 63u, 64u, 65u, 1000u}) {
    std::vector<int> count(size, 0);
    pool.run_ranges(size, 64, [&](std::size_t begin, std::size_t end) {
      EXPECT_EQ(begin % 64, 0u);
      EXPECT_LE(end - begin, 64u);
      for (std::size_t i = begin; i < end; ++i) ++count[i];
    });
    EXPECT_EQ(count, std::vector<int>(size, 1));
  }
}

TEST(ThreadPool, AChunkRunsNoOthersOnItsOwnPool) {
  for (const int threads : {1, 2}) {
    ThreadPool pool(threads), other(threads);
    EXPECT_THROW(pool.run(4, [&](int) { pool.run(1, [](int) {}); }), std::logic_error);
    std::atomic<int> done = 0;
    pool.run(4, [&](int) { other.run(3, [&](int) { ++done; }); });
    pool.run(4, [&](int) { ++done; });
    EXPECT_EQ(done, 16);
  }
}

TEST(ThreadPool, RefusesZeroThreads) { EXPECT_THROW(ThreadPool(0), std::logic_error); }

}  // namespace
}  // namespace redrive
