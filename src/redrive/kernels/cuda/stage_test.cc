// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cuda/stage.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "redrive/kernels/cuda/loop_device.h"

namespace redrive::kernels {
namespace {

struct Twice {
  std::span<const float> x;
  std::span<float> y;
  void operator()(std::size_t i) const { y[i] = 2 * x[i]; }
};

TEST(Stage, WorksOnCopiesAndBringsResultsHome) {
  LoopDevice device;
  Stage stage(device);
  const std::vector<float> x = {1, 2, 3};
  std::vector<float> y(3, 7), kept(3, 7);
  const auto x_there = stage.in(x);
  const auto y_there = stage.out(y);
  EXPECT_NE(x_there.data(), x.data());
  EXPECT_NE(y_there.data(), y.data());
  EXPECT_TRUE(std::isnan(y_there[1])) << "what is only written is not copied there";
  stage.for_each(3, Twice{x_there, y_there});
  EXPECT_EQ(y, kept) << "not before finish";
  stage.finish();
  EXPECT_EQ(y, (std::vector<float>{2, 4, 6}));
}

TEST(Stage, AddsToWhatWasThere) {
  struct Increment {
    std::span<float> x;
    void operator()(std::size_t i) const { x[i] += 1; }
  };
  LoopDevice device;
  Stage stage(device);
  std::vector<float> x = {1, 2, 3};
  stage.for_each(3, Increment{stage.in_out(x)});
  stage.finish();
  EXPECT_EQ(x, (std::vector<float>{2, 3, 4}));
}

TEST(Stage, WorksOnKeptNumbersWhereTheyAre) {
  struct Increment {
    std::span<float> x;
    void operator()(std::size_t i) const { x[i] += 1; }
  };
  LoopDevice device;
  std::vector<float> x = {1, 2, 3, 4}, y(2, 7);
  auto there = device.hold(x.size() * sizeof(float));
  device.to_device(there.get(), x.data(), x.size() * sizeof(float));
  device.kept.add(x, there);
  auto* const numbers = static_cast<float*>(there.get());
  {
    Stage stage(device);
    EXPECT_EQ(stage.in(x).data(), numbers);
    EXPECT_EQ(stage.in(std::span(x).subspan(1, 2)).data(), numbers + 1);
    EXPECT_EQ(x[1], 2);
    stage.for_each(2, Increment{stage.in_out(std::span(x).last(2))});
    stage.for_each(2, Twice{stage.in(std::span(x).last(2)), stage.out(y)});
    stage.finish();
  }
  EXPECT_EQ(y, (std::vector<float>{8, 10}));
  EXPECT_EQ(x[1], 2) << "nothing has changed it";
  EXPECT_TRUE(std::isnan(x[2])) << "out of date";
  EXPECT_EQ(numbers[2], 4);
  there.reset();
  x = {1, 2, 3, 4};
  Stage stage(device);
  stage.for_each(4, Increment{stage.in_out(x)});
  stage.finish();
  EXPECT_EQ(x, (std::vector<float>{2, 3, 4, 5})) << "as all others once it is not kept any more";
}

TEST(Stage, NothingIsNothing) {
  LoopDevice device;
  Stage stage(device);
  EXPECT_TRUE(stage.in({}).empty());
  EXPECT_TRUE(stage.out({}).empty());
  EXPECT_TRUE(stage.in_out({}).empty());
  EXPECT_TRUE(stage.scratch<double>(0).empty());
  stage.finish();
}

TEST(Stage, SumsEachTermOnce) {
  struct Index {
    double operator()(std::size_t i) const { return static_cast<double>(i); }
  };
  LoopDevice device;
  for (const std::size_t n : {1u, 4095u, 4096u, 4097u, 100000u}) {
    Stage stage(device);
    EXPECT_EQ(stage.sum(n, Index{}), 0.5 * static_cast<double>(n) * static_cast<double>(n - 1))
        << n;  // exact: whole numbers
  }
}

}  // namespace
}  // namespace redrive::kernels
