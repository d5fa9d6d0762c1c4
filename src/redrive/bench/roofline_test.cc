// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/roofline.h"

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"

namespace redrive::bench {
namespace {

TEST(Roofline, LeastTimesFollowFromCounts) {
  const StageCost cost{"stage", 2e9, 3e6, 0.5};
  EXPECT_NEAR(cost.least_ms({"arithmetic", 1, 1000}), 2, 1e-9);
  EXPECT_NEAR(cost.least_ms({"memory", 100, 1}), 3, 1e-9);
  const StageCost twice{"stage", 4e9, 6e6, 0.5};
  EXPECT_NEAR(twice.estimated_ms(kGpus[0], cost), 1, 1e-9) << "twice what was measured";
  EXPECT_NEAR(cost.estimated_ms({"half", kGpus[0].tflops / 2, kGpus[0].gb_per_s / 2}, cost), 1,
              1e-9);
}

TEST(Roofline, AStepIsSlowerThanItsLeastTime) {
  const auto isa = best_isa();
  if (!isa) GTEST_SKIP() << "400,000 Gaussians take the reference minutes";
  const std::vector<StepCost> steps = count_steps(*kernels::make_cpu_backend(*isa, 2));
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[0].width, 640);
  EXPECT_EQ(steps[1].counts.pixels, 4 * steps[0].counts.pixels);
  EXPECT_GT(steps[0].counts.drawn, 50'000);
  EXPECT_GT(steps[1].counts.drawn, steps[0].counts.drawn);
  EXPECT_GT(steps[1].counts.pairs, 2 * steps[0].counts.pairs);
  for (const StageCost& stage : steps[0].stages) {
    EXPECT_GT(stage.least_ms(kGpus[0]), 0) << stage.stage;
    EXPECT_LT(stage.least_ms(kGpus[0]), stage.h200_ms) << stage.stage;
  }
}

}  // namespace
}  // namespace redrive::bench
