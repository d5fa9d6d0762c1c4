// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/core_time.h"

#include <sched.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <ctime>
#include <fstream>
#include <thread>

#include <gtest/gtest.h>

namespace redrive {
namespace {

double thread_seconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Seconds in which this process, of one thread, waited for a core; below 0: unknown.
double waited_seconds() {
  std::ifstream file("/proc/self/schedstat");
  double ran_ns = 0, waited_ns = 0;
  return file >> ran_ns >> waited_ns ? 1e-9 * waited_ns : -1;
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

// Other processes on the same core take turns with this one: waiting for it is not work. What Linux
// has reported as waiting is subtracted from the wall time, whatever the machine makes of the rest.
TEST(CoreTimer, DoesNotCountWaitingForACore) {
  if (waited_seconds() < 0) GTEST_SKIP() << "Linux does not report waiting here";
  cpu_set_t all, one;
  sched_getaffinity(0, sizeof all, &all);
  CPU_ZERO(&one);
  for (int core = 0; core < CPU_SETSIZE && CPU_COUNT(&one) == 0; ++core)
    if (CPU_ISSET(core, &all)) CPU_SET(core, &one);
  ASSERT_EQ(sched_setaffinity(0, sizeof one, &one), 0);
  const pid_t other = fork();
  ASSERT_GE(other, 0);
  if (other == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    for (;;) work(1);
  }
  const auto begin = std::chrono::steady_clock::now();
  const auto seconds = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  };
  const CoreTimer timer;
  const double waited_before = waited_seconds();
  double waited = 0;
  while (waited < 0.03 && seconds() < 10) {
    work(0.005);
    waited = waited_seconds() - waited_before;
  }
  const double counted = timer.core_seconds(1), wall = seconds();
  kill(other, SIGKILL);
  waitpid(other, nullptr, 0);
  sched_setaffinity(0, sizeof all, &all);
  if (waited == 0) GTEST_SKIP() << "Linux does not report waiting here";
  EXPECT_LT(counted, wall - 0.9 * waited) << "of which " << waited << " s waiting";
}

}  // namespace
}  // namespace redrive
