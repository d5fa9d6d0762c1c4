// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/adam.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Adam, ConstantGradientMovesByTheLearningRate) {
  // With a constant gradient m_hat = g and v_hat = g^2 at every step, so each step is lr g / (|g| +
  // epsilon).
  for (const double gradient : {3.0, -0.01, 1e-6}) {
    double p = 1, m = 0, v = 0;
    for (int step = 1; step <= 50; ++step) {
      const double before = p;
      adam_update(adam_step(1e-3, step), gradient, p, m, v);
      // bias1 and bias2 are floats: 2^-24 relative each, and 1 - beta2 in float is off by 2^-24 /
      // 1e-3.
      EXPECT_NEAR(p - before, -1e-3 * gradient / (std::abs(gradient) + 1e-8), 1e-3 * 1e-4) << step;
    }
  }
}

TEST(Adam, FollowsTheAlgorithmOverChangingGradients) {
  // Algorithm 1 of the paper, written out with its own accumulators.
  const double beta1 = 0.9f, beta2 = 0.999f, epsilon = 1e-8f, rate = 5e-4f;
  double p = 0.3, m = 0, v = 0, expected = 0.3, expected_m = 0, expected_v = 0;
  for (int step = 1; step <= 100; ++step) {
    const double gradient = std::sin(0.7 * step) + 0.2;
    adam_update(adam_step(rate, step), gradient, p, m, v);
    expected_m = beta1 * expected_m + (1 - beta1) * gradient;
    expected_v = beta2 * expected_v + (1 - beta2) * gradient * gradient;
    const double m_hat = expected_m / (1 - std::pow(beta1, step)),
                 v_hat = expected_v / (1 - std::pow(beta2, step));
    expected -= rate * m_hat / (std::sqrt(v_hat) + epsilon);
    // Each step is about `rate` long; bias1, bias2 are rounded to float: 2 * 2^-24 relative a step.
    EXPECT_NEAR(p, expected, step * rate * 10 * 4 * 0x1p-24) << step;
  }
}

TEST(Adam, ZeroGradientKeepsAFreshParameter) {
  float p = 0.25f, m = 0, v = 0;
  adam_update(adam_step(5e-4, 1), 0.0f, p, m, v);
  EXPECT_EQ(p, 0.25f);
  EXPECT_EQ(m, 0);
  EXPECT_EQ(v, 0);
}

TEST(Adam, VanishingGradientStaysFinite) {
  float p = 0.25f, m = 0, v = 0;
  adam_update(adam_step(5e-4, 1), 1e-30f, p, m,
              v);  // its square underflows: epsilon carries the division
  EXPECT_NEAR(p, 0.25f, 1e-20f);
}

TEST(Adam, LazyStepKeepsMomentsOfZeroGradients) {
  AdamStep how = adam_step(5e-4, 7);
  double p = 0.25, m = 1e-3, v = 1e-6, plain_p = p, plain_m = m, plain_v = v;
  adam_update(how, 0.0, plain_p, plain_m, plain_v);
  EXPECT_NE(plain_p, 0.25);  // momentum goes on
  how.lazy = true;
  adam_update(how, 0.0, p, m, v);
  EXPECT_EQ(p, 0.25);
  EXPECT_EQ(m, 1e-3);
  EXPECT_EQ(v, 1e-6);
  double lazy_p = 0.25, lazy_m = 1e-3, lazy_v = 1e-6;
  plain_p = 0.25, plain_m = 1e-3, plain_v = 1e-6;
  adam_update(how, 2e-3, lazy_p, lazy_m, lazy_v);
  adam_update(adam_step(5e-4, 7), 2e-3, plain_p, plain_m, plain_v);
  EXPECT_EQ(lazy_p, plain_p);
}

TEST(ExponentialDecayRate, WarmsUpThenDecaysToTheLastFactor) {
  constexpr std::int64_t kWarmUp = 100;
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.1, 0, 0, kWarmUp), 0.02 / kWarmUp);
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.1, 0, kWarmUp / 2 - 1, kWarmUp), 0.01);
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.1, 0, kWarmUp - 1, kWarmUp), 0.02);
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.1, 0, kWarmUp, kWarmUp), 0.02);
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.01, 0.5, 1000000, kWarmUp), 0.002);
  EXPECT_DOUBLE_EQ(exponential_decay_rate(0.02, 0.1, 1, 1000000, kWarmUp), 0.002);
}

TEST(MultiStepLearningRate, DecaysAtEachMilestone) {
  const std::array<std::int64_t, 2> milestones = {10, 20};
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, milestones, 0), 8);
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, milestones, 9), 8);
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, milestones, 10), 4);
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, milestones, 19), 4);
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, milestones, 20), 2);
  EXPECT_EQ(multi_step_learning_rate(8, 0.5, {}, 1000), 8);
}

}  // namespace
}  // namespace redrive
