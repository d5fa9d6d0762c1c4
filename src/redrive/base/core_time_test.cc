// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/core_time.h"

#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <ctime>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

double thread_seconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Takes so much processor time, however long that takes.
void work(double seconds) {
  const double begin = thread_seconds();
  while (thread_seconds() < begin + seconds) {
  }
}

TEST(CoreTimer, CountsTheTimeOfWorkAndOfIdleCores) {
  const CoreTimer timer;
  work(0.02);
  EXPECT_GE(timer.core_seconds(1), 0.02);
  EXPECT_GE(timer.core_seconds(2), 0.02);
  const CoreTimer sleep;
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_GE(sleep.core_seconds(3), 0.9 * 3 * 0.02) << "cores that one thread leaves idle";
}

// Other processes on the same core take turns with this one: waiting for it is not work.
TEST(CoreTimer, DoesNotCountWaitingForACore) {
  cpu_set_t all, one;
  sched_getaffinity(0, sizeof all, &all);
  CPU_ZERO(&one);
  for (int core = 0; core < CPU_SETSIZE && CPU_COUNT(&one) == 0; ++core)
    if (CPU_ISSET(core, &all)) CPU_SET(core, &one);
  ASSERT_EQ(sched_setaffinity(0, sizeof one, &one), 0);
  std::vector<pid_t> others;
  for (int i = 0; i < 2; ++i) {
    others.push_back(fork());
    if (others.back() == 0)
      for (;;) work(1);
  }
  const CoreTimer timer;
  const auto begin = std::chrono::steady_clock::now();
  const double before = thread_seconds();
  work(0.05);
  const double own = thread_seconds() - before,
               wall =
                   std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count(),
               counted = timer.core_seconds(1);
  for (const pid_t other : others) {
    kill(other, SIGKILL);
    waitpid(other, nullptr, 0);
  }
  sched_setaffinity(0, sizeof all, &all);
  EXPECT_GT(wall, 1.6 * own);
  EXPECT_GE(counted, 0.99 * own);
  EXPECT_LT(counted, 1.3 * own);
}

}  // namespace
}  // namespace redrive
