// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/self_test.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/kernels/cuda/cuda_backend.h"

namespace redrive::kernels {
namespace {

using testing::HasSubstr;

TEST(SelfTest, PassesWhatAgreesWithRef) {
  EXPECT_EQ(self_test(*make_ref_backend()), std::nullopt);
  for (const bool tensor_cores : {true, false})
    EXPECT_EQ(self_test(*make_loop_backend(nullptr, tensor_cores)), std::nullopt) << tensor_cores;
  if (const auto isa = best_isa()) {
    EXPECT_EQ(self_test(*make_cpu_backend(*isa, 2)), std::nullopt);
    EXPECT_EQ(unless_it_errs([&] { return make_cpu_backend(*isa, 1); })->name(), "cpu");
  }
}

TEST(SelfTest, NamesTheStageThatIsOff) {
  LoopTroubles troubles;
  troubles.loses_warps = true;  // 16 samples of each network
  EXPECT_THAT(self_test(*make_loop_backend(nullptr, true, &troubles)).value_or("passed"),
              HasSubstr("grid network, forward gives what is not a number"));
  testing::internal::CaptureStderr();
  EXPECT_EQ(unless_it_errs([&] { return make_loop_backend(nullptr, true, &troubles); }), nullptr);
  EXPECT_THAT(
      testing::internal::GetCapturedStderr(),
      HasSubstr(
          "redrive: the GPU is not taken, its self-test failed: grid network, forward gives what"));
}

TEST(SelfTest, SaysWhatTheDeviceDiedOf) {
  for (const int works : {0, 1, 7, 20}) {
    LoopTroubles troubles;
    troubles.works = works;
    EXPECT_THAT(self_test(*make_loop_backend(nullptr, true, &troubles)).value_or("passed"),
                HasSubstr("the GPU failed"));
  }
}

TEST(SelfTest, OnAGpuPasses) {
  if (const auto obstacle = cuda_obstacle()) GTEST_SKIP() << "cuda: " << *obstacle;
  for (const bool tensor_cores : {true, false})
    EXPECT_EQ(self_test(*make_cuda_backend(1, tensor_cores)), std::nullopt) << tensor_cores;
}

}  // namespace
}  // namespace redrive::kernels
