// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/for_each_loaded.h"

#include <stdexcept>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(ForEachLoaded, UsesAllInOrder) {
  for (const int threads : {1, 3, 20})
    for (const std::size_t n : {0, 1, 7, 25}) {
      ThreadPool pool(threads);
      std::vector<std::size_t> used;
      for_each_loaded(
          n, pool, [](std::size_t i) { return 10 * i; },
          [&](std::size_t i, std::size_t loaded) {
            EXPECT_EQ(loaded, 10 * i);
            pool.run(2, [](int) {});
            used.push_back(i);
          });
      ASSERT_EQ(used.size(), n);
      for (std::size_t i = 0; i < n; ++i) EXPECT_EQ(used[i], i);
    }
}

TEST(ForEachLoaded, ThrowsWhatTheFirstLoadThrows) {
  ThreadPool pool(4);
  const auto load = [](std::size_t i) {
    if (i > 4) throw std::runtime_error(std::to_string(i));
    return i;
  };
  try {
    for_each_loaded(12, pool, load, [](std::size_t, std::size_t) {});
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "5");
  }
}

}  // namespace
}  // namespace redrive
