// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/time_offset_scan.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

/// Errors at offsets of -20, -15, ..., 20 ms. Their squares grow quadratically from each pair's own
/// best offset.
OffsetErrors parabolas(const std::vector<double>& best_ms, int points_per_pair) {
  OffsetErrors errors;
  for (double offset_ms = -20; offset_ms <= 20; offset_ms += 5) {
    errors.offsets_ms.push_back(offset_ms);
    errors.px.emplace_back();
  }
  for (std::size_t pair = 0; pair < best_ms.size(); ++pair)
    for (int p = 0; p < points_per_pair; ++p) {
      errors.pair.push_back(static_cast<int>(pair));
      const double off_px =
          0.5 + p / static_cast<double>(points_per_pair);  // 0.5..1.5 at the best offset
      for (std::size_t i = 0; i < errors.px.size(); ++i)
        errors.px[i].push_back(
            std::sqrt(off_px + 0.01 * std::pow(errors.offsets_ms[i] - best_ms[pair], 2)));
    }
  return errors;
}

TEST(OffsetScan, FindsTheMinimumOfAParabola) {
  const OffsetErrors errors = parabolas(std::vector<double>(8, -8.25), 40);
  const auto scan = error_scan(errors);
  ASSERT_EQ(scan.size(), 9u);
  EXPECT_NEAR(scan_minimum(scan).offset_ms, -8.25, 1e-9);
  // The lower of the two middle points of 0.5 + k / 40, and 0.01 times the square of 1.75 ms.
  EXPECT_NEAR(scan_minimum(scan).error_px, std::sqrt(0.5 + 19.0 / 40 + 0.01 * 1.75 * 1.75), 1e-12);
  EXPECT_NEAR(scan_minimum_sigma_ms(errors), 0, 1e-9);
  EXPECT_EQ(scan_minimum({{-5, 1}, {0, 2}, {5, 3}}).offset_ms, -5) << "no parabola at an end";
}

TEST(OffsetScan, LeavesOutOffsetsWithoutPoses) {
  OffsetErrors errors = parabolas(std::vector<double>(4, 3), 40);
  for (std::size_t p = 0; p < 80; ++p)
    errors.px.front()[p] = std::nan("");  // 80 of 160 are too few
  for (std::size_t p = 0; p < 60; ++p) errors.px.back()[p] = std::nan("");
  const auto scan = error_scan(errors);
  ASSERT_EQ(scan.size(), 8u);
  EXPECT_EQ(scan.front().offset_ms, -15);
  EXPECT_EQ(scan.back().offset_ms, 20);
  EXPECT_TRUE(error_scan(parabolas({1, 2}, 49)).empty());
  EXPECT_EQ(scan_minimum_sigma_ms(parabolas({1, 2, 3}, 100)),
            std::numeric_limits<double>::infinity());
}

// Pairs whose own offsets scatter by 3 ms: the mean of the stated sigmas is the standard deviation
// of repetitions.
TEST(OffsetScan, SigmaAgreesWithRepetitions) {
  constexpr int kRepetitions = 100, kPairs = 16;
  double sum = 0, squares = 0, stated = 0;
  for (int r = 0; r < kRepetitions; ++r) {
    std::vector<double> best_ms;
    for (int pair = 0; pair < kPairs; ++pair) {
      double twelve = -6;  // twelve uniform numbers: standard deviation 1
      for (int k = 0; k < 12; ++k)
        twelve +=
            random_unit(random_key(kStreamTest, static_cast<std::uint64_t>(r * kPairs + pair)), k);
      best_ms.push_back(2 + 3 * twelve);
    }
    const OffsetErrors errors = parabolas(best_ms, 12);
    const double found = scan_minimum(error_scan(errors)).offset_ms;
    sum += found;
    squares += found * found;
    stated += scan_minimum_sigma_ms(errors) / kRepetitions;
  }
  const double mean = sum / kRepetitions, shown = std::sqrt(squares / kRepetitions - mean * mean);
  // The mean of 16 such offsets would scatter by 3 / 4 ms; 100 repetitions measure a standard
  // deviation to 7 %.
  EXPECT_NEAR(mean, 2, 0.4);
  EXPECT_GT(shown, 0.5);
  EXPECT_LT(shown, 1.5);
  EXPECT_NEAR(stated / shown, 1, 0.3);
}

}  // namespace
}  // namespace redrive
