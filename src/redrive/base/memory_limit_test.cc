// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/memory_limit.h"

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

constexpr const char* kMeminfo = "MemTotal:       2048 kB\nMemFree:        1024 kB\n";

TEST(MemoryLimit, IsTheMachinesMemory) {
  TemporaryFolder root;
  root.write("proc/meminfo", kMeminfo);
  EXPECT_EQ(memory_bytes(root.path), 2048u * 1024);
  root.write("proc/meminfo", "MemFree: 7 kB\n");
  EXPECT_THROW(memory_bytes(root.path), IoError);
  EXPECT_GT(memory_bytes(), 1u << 26) << "this one";
}

TEST(MemoryLimit, IsTheLowestOfTheControlGroupAndItsParents) {
  TemporaryFolder root;
  root.write("proc/meminfo", kMeminfo);
  root.write("proc/self/cgroup", "0::/user/job\n");
  root.write("sys/fs/cgroup/user/job/memory.max", "max\n");
  EXPECT_EQ(memory_bytes(root.path), 2048u * 1024);
  root.write("sys/fs/cgroup/user/memory.max", "1500000\n");
  EXPECT_EQ(memory_bytes(root.path), 1500000u);
  root.write("sys/fs/cgroup/user/job/memory.max", "1000000\n");
  EXPECT_EQ(memory_bytes(root.path), 1000000u);
  root.write("sys/fs/cgroup/memory.max", "900000\n");
  EXPECT_EQ(memory_bytes(root.path), 900000u);
}

TEST(MemoryLimit, ReadsControlGroupsOfVersionOne) {
  TemporaryFolder root;
  root.write("proc/meminfo", kMeminfo);
  root.write("proc/self/cgroup", "11:cpu,cpuacct:/other\n4:memory:/docker/abc\n0::/\n");
  root.write("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n");
  EXPECT_EQ(memory_bytes(root.path), 2048u * 1024);
  root.write("sys/fs/cgroup/memory/docker/abc/memory.limit_in_bytes", "700000\n");
  root.write("sys/fs/cgroup/memory/other/memory.limit_in_bytes", "5\n");
  EXPECT_EQ(memory_bytes(root.path), 700000u);
}

}  // namespace
}  // namespace redrive
