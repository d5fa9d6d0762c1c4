// SPDX-License-Identifier: Apache-2.0
// The file read back by a parser of its own.
#include "redrive/model/gaussian_spz.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/files/gzip.h"
#include "redrive/field/splat_numbers.h"
#include "redrive/model/gaussians_testing.h"

namespace redrive {
namespace {

class Spz : public testing::TestWithParam<float> {};

TEST_P(Spz, HasTheNumbersOfTheGaussians) {
  constexpr std::size_t n = 300;
  const std::vector<float> storage = gaussians_of_test(n, GetParam());
  kernels::Gaussians gaussians;
  gaussians.n = n;
  gaussians.numbers = storage;
  const std::string bytes = gunzip(gaussian_spz(gaussians, 1));
  ASSERT_EQ(bytes.size(), 16 + n * (9 + 1 + 3 + 3 + 4 + 9));
  EXPECT_EQ(bytes.substr(0, 8), std::string("NGSP\3\0\0\0", 8));
  const auto byte = [&](std::size_t at) { return static_cast<unsigned char>(bytes[at]); };
  EXPECT_EQ(byte(8) + 256 * byte(9), n);
  EXPECT_EQ(byte(12), 1) << "degree";
  const int bits = byte(13);
  EXPECT_EQ(byte(14), 1) << "antialiased";
  for (std::size_t i = 0; i < n; ++i) {
    const SplatNumbers expected = splat_numbers(gaussians.numbers, i);
    std::size_t at = 16;
    for (int k = 0; k < 3; ++k) {
      const std::size_t p = at + 9 * i + 3 * k;
      std::int32_t fixed = byte(p) | byte(p + 1) << 8 | byte(p + 2) << 16;
      if (fixed & 0x800000) fixed -= 1 << 24;
      EXPECT_NEAR(std::ldexp(fixed, -bits), expected.position[k], std::ldexp(0.5, -bits));
    }
    at += 9 * n;
    EXPECT_NEAR(byte(at + i) / 255.0, 1 / (1 + std::exp(-expected.opacity)), 0.5 / 255 + 1e-9);
    at += n;
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR((byte(at + 3 * i + k) / 255.0 - 0.5) / 0.15, expected.dc[k], 0.5 / 255 / 0.15);
    at += 3 * n;
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(byte(at + 3 * i + k) / 16.0 - 10, expected.log_scale[k], 1.0 / 32);
    at += 3 * n;
    std::uint32_t packed = 0;
    for (int k = 3; k >= 0; --k) packed = packed << 8 | byte(at + 4 * i + k);
    double xyzw[4], rest2 = 1;
    const int largest = static_cast<int>(packed >> 30);
    for (int k = 3; k >= 0; --k) {
      if (k == largest) continue;
      xyzw[k] = (packed & 511) / 511.0 / std::sqrt(2.0) * (packed & 512 ? -1 : 1);
      rest2 -= xyzw[k] * xyzw[k];
      packed >>= 10;
    }
    xyzw[largest] = std::sqrt(rest2);
    double cosine = xyzw[3] * expected.quaternion[0];
    for (int k = 0; k < 3; ++k) cosine += xyzw[k] * expected.quaternion[1 + k];
    EXPECT_GT(std::abs(cosine), 1 - 1e-5);
    at += 4 * n;
    for (int j = 0; j < 3; ++j)
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR((byte(at + 9 * i + 3 * j + c) - 128) / 128.0, expected.rest[c][j], 0.5 / 128);
  }
  EXPECT_EQ(gunzip(gaussian_spz(gaussians, 0)).size(), 16 + n * 20);
}

TEST(GaussianSpz, IsReadAsABody) {
  constexpr std::size_t n = 40;
  const std::vector<float> storage = gaussians_of_test(n, 1);
  kernels::Gaussians gaussians;
  gaussians.n = n;
  gaussians.numbers = storage;
  const ActorBody body = parse_actor_body(gaussian_spz(gaussians, 1), "car.spz");
  ASSERT_EQ(body.n, n);
  for (std::size_t i = 0; i < n; ++i) {
    const SplatNumbers expected = splat_numbers(gaussians.numbers, i),
                       read = splat_numbers(body.numbers, i);
    double cosine = 0;
    for (std::size_t k = 0; k < 4; ++k) cosine += read.quaternion[k] * expected.quaternion[k];
    EXPECT_GT(std::abs(cosine), 1 - 1e-5);
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_NEAR(read.position[k], expected.position[k], std::ldexp(0.5, -12));
      EXPECT_NEAR(read.log_scale[k], expected.log_scale[k], 1.0 / 32);
      EXPECT_NEAR(read.dc[k], expected.dc[k], 0.5 / 255 / 0.15 + 1e-6);
      for (std::size_t j = 0; j < 3; ++j)
        EXPECT_NEAR(read.rest[k][j], expected.rest[k][j], 0.5 / 128 + 1e-6);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Extents, Spz, testing::Values(30.0f, 5000.0f));

}  // namespace
}  // namespace redrive
