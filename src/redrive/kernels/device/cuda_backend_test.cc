// SPDX-License-Identifier: Apache-2.0
// Interface of the CUDA backend. tests/conformance compares its results, except for the encoding,
// whose error is bounded here.
#include "redrive/kernels/device/cuda_backend.h"

#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/field/positional_encoding.h"
#include "redrive/kernels/device/nerf_fp32_network.h"

namespace redrive::kernels {
namespace {

TEST(CudaBackend, IsAvailableOrReturnsTheObstacle) {
  if (const auto obstacle = cuda_obstacle()) {
    EXPECT_FALSE(obstacle->empty());
    EXPECT_EQ(cuda_obstacle(), obstacle) << "a second call returns the same";
    return;
  }
  EXPECT_THAT(cuda_description(),
              testing::ContainsRegex("compute capability [0-9]+\\.[0-9], [0-9.]+ GiB, driver"));
  const auto backend = make_cuda_backend(3);
  EXPECT_EQ(backend->name(), "cuda");
  EXPECT_EQ(backend->threads(), 3);
  EXPECT_EQ(backend->device(), cuda_description());
}

TEST(LoopBackend, DownloadsAndUploadsResidentNumbers) {
  const auto backend = make_loop_backend();
  Buffer<float> p(8);
  std::vector<float> m(8), v(8), gradients(8, 1.0f);
  make_resident(*backend, p);
  const auto step = [&] { backend->adam(adam_step(0.5, 1), gradients, p, m, v); };
  step();
  EXPECT_EQ(gradients, std::vector<float>(8));
  backend->download(p.span().subspan(2, 3));
  for (std::size_t i = 0; i < 8; ++i) {
    if (i < 2 || i > 4)
      EXPECT_TRUE(std::isnan(p[i])) << i;
    else
      EXPECT_NEAR(p[i], -0.5, 1e-6) << i;  // Adam's first step is the learning rate
  }
  p[3] = 7;
  backend->upload(p.span().subspan(3, 1));
  backend->download(p.span());
  EXPECT_EQ(p[3], 7);
  EXPECT_NEAR(p[7], -0.5, 1e-6);
  Buffer<float> other = std::move(p);  // moving keeps the numbers resident
  backend->adam(adam_step(0, 1), gradients, other, m, v);
  EXPECT_TRUE(std::isnan(other[7]));
  other = {};
  EXPECT_EQ(backend->make_resident({}), nullptr);
}

TEST(LoopBackend, CountsCopiedBytes) {
  TransferCounts copies;
  const auto backend = make_loop_backend(&copies);
  Buffer<float> resident(100);
  const std::vector<float> other(10, 2.0f);
  make_resident(*backend, resident);
  EXPECT_EQ(copies.to_device, 400u);
  backend->fill(resident.span().first(50), 1);
  EXPECT_EQ(copies.to_host, 0u);
  double mean = 0;
  backend->mean(resident.span(), &mean);
  EXPECT_EQ(mean, 0.5);
  EXPECT_EQ(copies.to_host, sizeof(double)) << "only the mean";
  EXPECT_EQ(copies.waits, 1u);
  backend->mean(other, &mean);
  EXPECT_EQ(mean, 2);
  EXPECT_EQ(copies.to_device, 440u);
}

TEST(EncodePoint, IsAccurateForLargeAngles) {
  constexpr int kOctaves = 10;
  std::vector<float> got(encoded_size(kOctaves));
  std::vector<double> expected(got.size());
  for (std::uint64_t i = 0; i < 1000; ++i) {
    double point[3];
    for (int k = 0; k < 3; ++k)
      point[k] = 2.0 * random_unit(random_key(5, kStreamTest), 3 * i + k) - 1;
    encode_point(point, kOctaves, got.data());
    positional_encoding(point, kOctaves, expected.data());
    // The angle, at most pi, rounds by 2^-23; its sine and cosine by one unit of 2^-24. The angle
    // of the expected value rounds by 2^-53 of 1600, twice.
    for (std::size_t c = 0; c < got.size(); ++c)
      ASSERT_NEAR(got[c], expected[c], 0x1p-23 + 0x1p-24 + 4e-13) << c;
  }
}

TEST(EncodePoint, AgreesAtQuarterTurns) {
  const double point[3] = {0.5, -0.25, 1};
  float got[9 + 6];
  encode_point(point, 2, got);
  const double half = std::sqrt(0.5),
               expected[] = {0.5, -0.25, 1, 1, 0, 0, -1, -half, half, -1, 0, 0, -1, 0, 1};
  for (int c = 0; c < 15; ++c) EXPECT_NEAR(got[c], expected[c], 2e-7) << c;
}

}  // namespace
}  // namespace redrive::kernels
