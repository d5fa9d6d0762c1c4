// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/progress.h"

#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(ProgressText, HasABarAndTheTimeLeftOnATerminal) {
  EXPECT_EQ(progress_text("decoding images", 30, 100, 6, true),
            "decoding images  [######..............]  30 %  0:14 left");
  EXPECT_EQ(progress_text("decoding images", 100, 100, 4000, true),
            "decoding images  [####################] 100 %  0:00 left");
}

TEST(ProgressText, HasNumbersInAPipe) {
  EXPECT_EQ(progress_text("decoding images", 30, 100, 6, false),
            "decoding images: 30 of 100, 0:14 left");
  // 1 of 100 after 100 s: 9900 s.
  EXPECT_EQ(progress_text("decoding images", 1, 100, 100, false),
            "decoding images: 1 of 100, 2:45:00 left");
}

// No time left is known for work that is not counted, or before its first part is done.
TEST(ProgressText, SaysHowLongItHasTakenWhereNothingIsCounted) {
  EXPECT_EQ(progress_text("fitting planes", 0, 0, 65, false), "fitting planes: 1:05 so far");
  EXPECT_EQ(progress_text("fitting planes", 0, 0, 65, true), "fitting planes  1:05");
  EXPECT_EQ(progress_text("decoding images", 0, 100, 3, false), "decoding images: 0:03 so far");
}

TEST(ProgressLine, IsDueTwoSecondsAfterWorkBeganAndThenEveryFive) {
  EXPECT_FALSE(progress_line_due(11.9, 10, 10, false));
  EXPECT_TRUE(progress_line_due(12, 10, 10, false));
  EXPECT_FALSE(progress_line_due(16.9, 12, 10, true));
  EXPECT_TRUE(progress_line_due(17, 12, 10, true));
  EXPECT_TRUE(progress_line_due(17, 12, 16.5, false)) << "of short parts, one";
}

// Threads count while others begin and end parts of the work.
TEST(ProgressThreads, CountAndNest) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([] {
      for (int i = 0; i < 20; ++i) {
        Progress whole("whole", 10);
        Progress part("part");
        whole.count();
        part.show("part " + std::to_string(i));
      }
    });
  for (std::thread& thread : threads) thread.join();
}

}  // namespace
}  // namespace redrive
