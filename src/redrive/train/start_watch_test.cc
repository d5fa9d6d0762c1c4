// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/start_watch.h"

#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using ::testing::HasSubstr;

struct Verdict {
  std::int64_t step = -1;
  std::string reason;
};

Verdict watch(double variance, const std::function<StepResult(std::int64_t)>& result_of,
              std::int64_t steps = 2000) {
  StartWatch state;
  for (std::int64_t step = 0; step < steps; ++step) {
    StepResult result = result_of(step);
    result.colour_variance = variance;
    if (const auto reason = watch_start(result, step, &state)) return {step, *reason};
  }
  return {};
}

StepResult result(double mse, double opacity = 0.5, bool finite = true) {
  StepResult out;
  out.loss = out.rgb_mse = mse;
  out.opacity = opacity;
  out.finite = finite;
  return out;
}

/// Colour variance of half black and half white pixels.
constexpr double kBlackAndWhite = 0.25;

TEST(StartWatch, DetectsADeadFieldAfterTwentySteps) {
  const Verdict verdict = watch(kBlackAndWhite, [](auto) { return result(0.5, 0); });
  EXPECT_EQ(verdict.step, 19);
  EXPECT_THAT(verdict.reason, HasSubstr("dead"));
}

TEST(StartWatch, ARecoveringOpacityIsNotDead) {
  EXPECT_EQ(watch(kBlackAndWhite,
                  [](auto step) { return result(0.1 / (1 + step), step % 20 == 19 ? 1e-3 : 0); })
                .step,
            -1);
}

TEST(StartWatch, EmptySpaceInBlackImagesIsNotDead) {
  EXPECT_EQ(watch(0, [](auto) { return result(0, 0); }).step, -1);
}

TEST(StartWatch, NotFiniteIsDivergingOnlyInTheStart) {
  const auto bad_at = [](std::int64_t bad) {
    return watch(kBlackAndWhite,
                 [=](auto step) { return result(0.1 / (1 + step), 0.5, step != bad); });
  };
  EXPECT_EQ(bad_at(7).step, 7);
  EXPECT_THAT(bad_at(7).reason, HasSubstr("diverging"));
  EXPECT_EQ(bad_at(999).step, 999);
  EXPECT_EQ(bad_at(1000).step, -1);
}

TEST(StartWatch, LossThatDoesNotFallIsDiverging) {
  // Half the pixels are black, half white, and the field is one of them everywhere: error 1/2. A
  // constant grey has 1/4.
  const Verdict verdict =
      watch(kBlackAndWhite, [](auto step) { return result(step < 20 ? 0.52 : 0.5); });
  EXPECT_EQ(verdict.step, 499);
  EXPECT_THAT(verdict.reason, HasSubstr("diverging"));
}

TEST(StartWatch, LossThatFallsIsNot) {
  EXPECT_EQ(watch(kBlackAndWhite, [](auto step) { return result(step < 20 ? 0.5 : 0.44); }).step,
            -1);
}

TEST(StartWatch, OneConstantColourIsNot) {  // correct from the first step: the loss cannot fall
  EXPECT_EQ(watch(0, [](auto step) { return result(step < 20 ? 1e-7 : 2e-6); }).step, -1);
}

TEST(StartWatch, NoiseIsNot) {  // the mean colour from the start is optimal
  EXPECT_EQ(watch(0.0625, [](auto step) { return result(step < 20 ? 0.0624 : 0.0626); }).step, -1);
}

}  // namespace
}  // namespace redrive
