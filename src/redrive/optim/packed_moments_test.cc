// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/packed_moments.h"

#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(PackedMoments, KeepWhatTheirBitsHold) {
  for (const float first : {0.0f, 1.0f, -1.5f, 0x1.fep-20f, -0x1.02p30f})
    for (const float second : {0.0f, 1.0f, 0x1.ffp-60f, 0x1.01p40f}) {
      const std::uint32_t packed = pack_moments(first, second);
      EXPECT_EQ(unpacked_first(packed), first);
      EXPECT_EQ(unpacked_second(packed), second);
    }
  EXPECT_EQ(pack_moments(0, 0), 0u) << "fresh moments are zeros";
}

TEST(PackedMoments, AreRoundedToNearest) {
  double worst_first = 0, worst_second = 0, sum = 0;
  constexpr int kNumbers = 10'000;
  for (int i = 0; i < kNumbers; ++i) {
    const float x = 1 + static_cast<float>(i) / kNumbers;
    const std::uint32_t packed = pack_moments(-x, x);
    const double first = -double(unpacked_first(packed)) / double(x) - 1,
                 second = double(unpacked_second(packed)) / double(x) - 1;
    worst_first = std::max(worst_first, std::fabs(first));
    worst_second = std::max(worst_second, std::fabs(second));
    sum += second;
  }
  EXPECT_LE(worst_first, 0x1p-8);
  EXPECT_GT(worst_first, 0x1p-9);
  EXPECT_LE(worst_second, 0x1p-9);
  EXPECT_GT(worst_second, 0x1p-10);
  EXPECT_NEAR(sum / kNumbers, 0, 1e-5) << "neither up nor down";
  EXPECT_EQ(unpacked_first(pack_moments(0x1.ffp0f, 0)), 2.0f);
  EXPECT_EQ(unpacked_second(pack_moments(0, 0x1.ff8p0f)), 2.0f);
}

// A decay of 1 % in a step is more than a rounding.
TEST(PackedMoments, DecayAsFloatsDo) {
  std::uint32_t packed = pack_moments(1, 1);
  for (int step = 0; step < 300; ++step)
    packed = pack_moments(0.9f * unpacked_first(packed), 0.99f * unpacked_second(packed));
  EXPECT_NEAR(std::log(unpacked_second(packed)) / (300 * std::log(0.99)), 1, 0.05);
  EXPECT_NEAR(std::log(unpacked_first(packed)) / (300 * std::log(0.9)), 1, 0.01);
}

}  // namespace
}  // namespace redrive
