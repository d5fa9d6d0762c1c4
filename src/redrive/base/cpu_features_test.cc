// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/cpu_features.h"

#include <fstream>
#include <sstream>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(CpuFeatures, NamesRoundTrip) {
  EXPECT_EQ(all_isas().size(), 3u);
  for (const Isa isa : all_isas()) EXPECT_EQ(isa_from_name(isa_name(isa)), isa);
  EXPECT_EQ(isa_from_name("neon"), std::nullopt);
}

// /proc/cpuinfo independently lists the features that the processor has and Linux has enabled.
TEST(CpuFeatures, AgreesWithTheKernel) {
  std::ifstream file("/proc/cpuinfo");
  std::stringstream text;
  text << file.rdbuf();
  const std::string cpuinfo = text.str() + " ";
  if (cpuinfo.find("flags\t") == std::string::npos)
    GTEST_SKIP() << "/proc/cpuinfo lists no flags here";
  const auto flag = [&](const std::string& name) {
    return cpuinfo.find(" " + name + " ") != std::string::npos ||
           cpuinfo.find(" " + name + "\n") != std::string::npos;
  };
  const bool avx2 = flag("avx2") && flag("fma");
  const bool avx512 =
      avx2 && flag("avx512f") && flag("avx512bw") && flag("avx512dq") && flag("avx512vl");
  const bool bf16 =
      avx512 && flag("avx512_bf16") && flag("gfni") && flag("avx512vbmi") && flag("avx512_vbmi2");
  EXPECT_EQ(!isa_obstacle(Isa::kAvx2), avx2);
  EXPECT_EQ(!isa_obstacle(Isa::kAvx512), avx512);
  EXPECT_EQ(!isa_obstacle(Isa::kAvx512Bf16), bf16);
}

TEST(CpuFeatures, TheFastestIsaIsUsable) {
  const auto best = best_isa();
  EXPECT_EQ(best.has_value(), !isa_obstacle(Isa::kAvx2));
  if (best) {
    EXPECT_EQ(isa_obstacle(*best), std::nullopt);
  }
}

TEST(CpuFeatures, DescribesTheMachine) {
  EXPECT_GE(hardware_threads(), 1);
  EXPECT_FALSE(cpu_model_name().empty());
}

}  // namespace
}  // namespace redrive
