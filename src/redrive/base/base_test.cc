// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cmath>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/buffer.h"
#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

TEST(Error, MessagesNameFileFieldAndRule) {
  EXPECT_STREQ(InputError("a.json", "CAM.fx", "-1", "must be positive").what(),
               "a.json: CAM.fx = -1: must be positive");
  EXPECT_STREQ(InputError("a.json", "", "", "missing").what(), "a.json: missing");
  EXPECT_STREQ(UsageError("--near", "0", "must be positive").what(), "--near 0: must be positive");
  EXPECT_STREQ(IoError("a.png", "disk full").what(), "a.png: disk full");
}

TEST(Error, CheckPrintsBothValues) {
  const int size = 3;
  try {
    REDRIVE_CHECK_OP(size, ==, 4);
    FAIL();
  } catch (const std::logic_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("size == 4 (3 vs 4)"));
  }
  EXPECT_NO_THROW(REDRIVE_CHECK(size == 3));
}

TEST(Buffer, IsAlignedAndZero) {
  for (const std::size_t size : {1u, 17u, 3u << 20}) {
    const Buffer<float> buffer(size);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(buffer.data()) % 64, 0u);
    EXPECT_EQ(buffer[0], 0);
    EXPECT_EQ(buffer[size - 1], 0);
  }
  EXPECT_EQ(Buffer<float>(0).size(), 0u);
}

TEST(Random, UnitIsUniform) {
  // Mean of n uniform numbers: 1/2 with standard deviation 1/sqrt(12 n); variance of one: 1/12. Six
  // sigma.
  constexpr int n = 1 << 20;
  const std::uint64_t key = random_key(7, kStreamTest);
  double sum = 0, squares = 0;
  std::array<int, 16> histogram{};
  for (int i = 0; i < n; ++i) {
    const float u = random_unit(key, i);
    ASSERT_GE(u, 0);
    ASSERT_LT(u, 1);
    sum += u;
    squares += (u - 0.5) * (u - 0.5);
    ++histogram[static_cast<int>(u * 16)];
  }
  EXPECT_NEAR(sum / n, 0.5, 6 / std::sqrt(12.0 * n));
  EXPECT_NEAR(squares / n, 1.0 / 12,
              6 * std::sqrt(1.0 / 180 / n));  // Var (u - 1/2)^2 = 1/80 - 1/144 = 1/180
  for (const int count : histogram) EXPECT_NEAR(count, n / 16, 6 * std::sqrt(n / 16.0));
}

TEST(Random, StreamsDiffer) {
  std::set<std::uint64_t> keys;
  for (std::uint64_t seed = 0; seed < 10; ++seed)
    for (std::uint64_t stream = 1; stream < 6; ++stream)
      for (std::uint64_t counter = 0; counter < 10; ++counter)
        keys.insert(random_key(seed, stream, counter));
  EXPECT_EQ(keys.size(), 500u);
}

TEST(Random, PermutationVisitsEachIndexOnceInAnotherOrder) {
  for (const std::uint64_t size : {1u, 2u, 3u, 4u, 5u, 64u, 1000u, 4097u}) {
    std::set<std::uint64_t> seen;
    std::uint64_t fixed = 0;
    for (std::uint64_t i = 0; i < size; ++i) {
      const std::uint64_t image = permute_index(random_key(1, kStreamTest), i, size);
      ASSERT_LT(image, size);
      seen.insert(image);
      fixed += image == i;
    }
    EXPECT_EQ(seen.size(), size);
    // A random permutation has 1 fixed point on average; P(12 or more) < 1e-9.
    if (size >= 64) {
      EXPECT_LT(fixed, 12u) << size;
    }
  }
}

}  // namespace
}  // namespace redrive
