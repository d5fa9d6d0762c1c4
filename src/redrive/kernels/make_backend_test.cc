// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/backend_group.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/nccl.h"

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
  EXPECT_EQ(refusal({"gpu"}), "--backend gpu: must be one of auto, ref, cpu, cuda");
  EXPECT_EQ(refusal({"auto", "sse9"}),
            "--isa sse9: must be one of auto, avx2, avx512, avx512-bf16, amx-bf16");
  EXPECT_THAT(refusal({"ref", "avx2"}),
              HasSubstr("--isa avx2: the ref backend has no instruction sets"));
  EXPECT_THAT(refusal({"cuda", "avx2"}),
              HasSubstr("--isa avx2: the cuda backend has no instruction sets"));
  EXPECT_THAT(refusal({"auto", "auto", -1}), HasSubstr("--threads -1"));
  EXPECT_THAT(refusal({"auto", "auto", 1 << 20}), HasSubstr("--threads 1048576"));
}

TEST(Registry, RefIsAlwaysAvailable) {
  const auto backend = make_backend({"ref", "auto", 2});
  EXPECT_EQ(describe(*backend), "backend=ref threads=1");
}

TEST(Registry, CudaIsMadeOrRejectedWithTheObstacle) {
  if (const auto obstacle = cuda_obstacle())
    EXPECT_EQ(refusal({"cuda"}), "--backend cuda: " + *obstacle);
  else
    EXPECT_EQ(describe(*make_backend({"cuda", "auto", 2})), "backend=cuda threads=2");
}

TEST(Registry, AutoTakesTheGpuOrTheFastestIsa) {
  const auto backend = make_backend({"auto", "auto", 2});
  if (!cuda_obstacle()) {
    EXPECT_EQ(backend->name(), "cuda");
    return;
  }
  EXPECT_EQ(backend->isa(), best_isa());
  EXPECT_EQ(backend->name(), best_isa() ? "cpu" : "ref");
}

std::string refusal_of_gpus(const BackendChoice& choice, int gpus) {
  try {
    make_backend_group(choice, gpus);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Registry, SeveralGpusAreMadeOrRejectedWithTheReason) {
  EXPECT_EQ(refusal_of_gpus({"cpu"}, 2),
            "--gpus 2: must be 1 with --backend cpu, which computes on the processor");
  EXPECT_EQ(refusal_of_gpus({"ref"}, 4),
            "--gpus 4: must be 1 with --backend ref, which computes on the processor");
  EXPECT_THAT(refusal_of_gpus({"auto", "avx2"}, 2),
              HasSubstr("must be 1 with --backend auto --isa avx2"));
  EXPECT_THAT(refusal_of_gpus({"cuda", "avx2"}, 2),
              HasSubstr("--isa avx2: the cuda backend has no instruction sets"));
  for (const char* name : {"auto", "cuda"}) {
    if (const auto obstacle = cuda_obstacle())
      EXPECT_EQ(refusal_of_gpus({name}, 2), "--gpus 2: no GPU can be used: " + *obstacle);
    else
      EXPECT_THAT(refusal_of_gpus({name}, cuda_gpus() + 1),
                  HasSubstr("must be " + std::to_string(cuda_gpus()) + " or less"));
  }
  const BackendGroup one = make_backend_group({"ref"}, 1);
  ASSERT_EQ(one.backends.size(), 1u);
  EXPECT_EQ(one.backends[0]->name(), "ref");
  EXPECT_EQ(one.reduction, nullptr);
}

TEST(Nccl, IsAvailableOrReturnsTheObstacle) {
  if (const auto obstacle = nccl_obstacle())
    EXPECT_THAT(*obstacle, HasSubstr("libnccl.so.2"));
  else
    EXPECT_THAT(nccl_version(), testing::MatchesRegex("[2-9]\\.[0-9]+\\.[0-9]+"));
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
