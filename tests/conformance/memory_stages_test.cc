// SPDX-License-Identifier: Apache-2.0
// Memory and vector stages of every backend, with numbers on the host or resident in the backend's
// memory.
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "candidates.h"
#include "redrive/base/buffer.h"

namespace redrive::kernels::conformance {
namespace {

class MemoryStages : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, MemoryStages, testing::ValuesIn(candidates()), name_of);

double mean_of(Backend& backend, std::span<const float> numbers) {
  double mean = NAN;
  backend.mean(numbers, &mean);
  return mean;
}

TEST_P(MemoryStages, FillSetsEveryValue) {
  const auto backend = make();
  Buffer<float> resident(1000);
  std::vector<float> here(1000);
  make_resident(*backend, resident);
  for (const std::span<float> numbers : {resident.span(), std::span(here)}) {
    backend->fill(numbers.subspan(100, 700), 0.75f);
    backend->fill(numbers.first(0), 3);
    backend->download(numbers);
    for (std::size_t i = 0; i < numbers.size(); ++i)
      ASSERT_EQ(numbers[i], i >= 100 && i < 800 ? 0.75f : 0) << i;
  }
}

TEST_P(MemoryStages, MeanIsSummedInDouble) {
  const auto backend = make();
  for (const std::size_t n : {1u, 63u, 64u, 65u, 4096u, 4097u, 20011u}) {
    // Integers whose sum is exact in double but not in float.
    Buffer<float> resident(n);
    double expected = 0;
    for (std::size_t i = 0; i < n; ++i)
      expected += resident[i] = static_cast<float>((1 << 23) + 3 * i);
    expected /= n;
    EXPECT_EQ(mean_of(*backend, resident), expected);
    make_resident(*backend, resident);
    EXPECT_EQ(mean_of(*backend, resident), expected);
    EXPECT_EQ(mean_of(*backend, resident.span().last(1)), resident[n - 1]);
  }
  EXPECT_THROW(mean_of(*backend, {}), std::logic_error);
  const std::vector<float> numbers = random_floats(5000, 400, -1, 1);
  EXPECT_EQ(mean_of(*backend, numbers), mean_of(*make(), numbers)) << "the same bits again";
}

TEST_P(MemoryStages, ResultsStayOnTheDevice) {
  const auto backend = make();
  Buffer<double> resident(3);
  make_resident(*backend, resident);
  const std::vector<float> numbers = {1, 2, 6}, corrupted = {NAN};
  backend->mean(numbers, &resident[0]);
  backend->not_finite(corrupted, &resident[2]);
  backend->download(as_floats(std::as_const(resident).span()));
  EXPECT_EQ(resident[0], 3);
  EXPECT_EQ(resident[1], 0);
  EXPECT_GT(resident[2], 0);
}

TEST_P(MemoryStages, NotFiniteFindsInfinityAndNaN) {
  const auto backend = make();
  const auto finite = [&](std::span<const float> numbers) {
    double count = NAN;
    backend->not_finite(numbers, &count);
    return count == 0;
  };
  EXPECT_TRUE(finite({}));
  for (const std::size_t n : {1u, 100u, 5000u}) {
    std::vector<float> numbers(n, std::numeric_limits<float>::max());
    EXPECT_TRUE(finite(numbers));
    for (const float bad : {INFINITY, -INFINITY, NAN})
      for (const std::size_t at : {std::size_t{0}, n / 2, n - 1}) {
        std::vector<float> corrupted = numbers;
        corrupted[at] = bad;
        EXPECT_FALSE(finite(corrupted)) << bad << " at " << at << " of " << n;
      }
  }
}

}  // namespace
}  // namespace redrive::kernels::conformance
