// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/self_test.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/kernels/device/cuda_backend.h"

namespace redrive::kernels {
namespace {

using testing::HasSubstr;

TEST(SelfTest, PassesABackendThatAgreesWithRef) {
  EXPECT_EQ(self_test(*make_ref_backend()), std::nullopt);
  for (const bool tensor_cores : {true, false})
    EXPECT_EQ(self_test(*make_loop_backend(nullptr, tensor_cores)), std::nullopt) << tensor_cores;
  if (const auto isa = best_isa()) {
    EXPECT_EQ(self_test(*make_cpu_backend(*isa, 2)), std::nullopt);
    EXPECT_EQ(make_if_self_test_passes([&] { return make_cpu_backend(*isa, 1); })->name(), "cpu");
  }
}

TEST(SelfTest, NamesTheFailingStage) {
  InjectedFaults faults;
  faults.skips_first_warp = true;  // 16 samples of each network
  EXPECT_THAT(self_test(*make_loop_backend(nullptr, true, &faults)).value_or("passed"),
              HasSubstr("grid network, forward returns NaN"));
  testing::internal::CaptureStderr();
  EXPECT_EQ(make_if_self_test_passes([&] { return make_loop_backend(nullptr, true, &faults); }),
            nullptr);
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("redrive: the GPU is not used, its self-test failed: grid network, "
                        "forward returns NaN"));
}

TEST(SelfTest, ReportsTheDeviceError) {
  for (const int works : {0, 1, 7, 20}) {
    InjectedFaults faults;
    faults.kernel_launches = works;
    EXPECT_THAT(self_test(*make_loop_backend(nullptr, true, &faults)).value_or("passed"),
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
