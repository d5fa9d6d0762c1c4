// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/backend.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

using testing::HasSubstr;

std::string refusal(const BackendChoice& choice) {
  try {
    make_backend(choice);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Registry, RejectsImpossibleChoices) {
  EXPECT_EQ(refusal({"cuda"}), "--backend cuda: must be one of auto, ref, cpu, vulkan");
  EXPECT_EQ(refusal({"auto", "sse9"}),
            "--isa sse9: must be one of auto, avx2, avx512, avx512-bf16");
  EXPECT_THAT(refusal({"ref", "avx2"}),
              HasSubstr("--isa avx2: the ref backend has no instruction sets"));
  EXPECT_THAT(refusal({"cpu", "auto", 1, "GPU"}), HasSubstr("--device GPU: chooses a GPU"));
  EXPECT_THAT(refusal({"auto", "avx2", 1, "GPU"}), HasSubstr("--isa avx2: GPUs"));
  EXPECT_THAT(refusal({"auto", "auto", 1, "no such GPU"}), HasSubstr("--device no such GPU: "));
  EXPECT_THAT(refusal({"auto", "auto", -1}), HasSubstr("--threads -1"));
  EXPECT_THAT(refusal({"auto", "auto", 1 << 20}), HasSubstr("--threads 1048576"));
}

TEST(Registry, RefIsAlwaysAvailable) {
  const auto backend = make_backend({"ref", "auto", 2});
  EXPECT_EQ(describe(*backend), "backend=ref threads=1");
}

TEST(Registry, AutoTakesTheFastestIsa) {
  const auto backend = make_backend({"auto", "auto", 2});
  EXPECT_EQ(backend->isa(), best_isa());
  EXPECT_EQ(backend->name(), best_isa() ? "cpu" : "ref");
}

class EveryIsa : public testing::TestWithParam<Isa> {};

TEST_P(EveryIsa, IsMadeOrRejectedWithTheObstacle) {
  const std::string name(isa_name(GetParam()));
  const BackendChoice choice{"cpu", name, 2};
  if (const auto obstacle = isa_obstacle(GetParam())) {
    EXPECT_THAT(refusal(choice),
                HasSubstr("--isa " + name + ": " + *obstacle + " (this machine offers "));
    return;
  }
  EXPECT_EQ(describe(*make_backend(choice)), "backend=cpu isa=" + name + " threads=2");
}

INSTANTIATE_TEST_SUITE_P(Isas, EveryIsa, testing::ValuesIn(all_isas()));

}  // namespace
}  // namespace redrive::kernels
