// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device/stage.h"

#include <cmath>
#include <cstdint>
#include <numeric>

#include <gtest/gtest.h>

#include "redrive/kernels/device/loop_device.h"

namespace redrive::kernels {
namespace {

struct Twice {
  std::span<const float> x;
  std::span<float> y;
  void operator()(std::size_t i) const { y[i] = 2 * x[i]; }
};

TEST(Stage, CopiesArgumentsAndResults) {
  LoopDevice device;
  Stage stage(device);
  const std::vector<float> x = {1, 2, 3};
  std::vector<float> y(3, 7), unchanged(3, 7);
  const auto device_x = stage.in(x);
  const auto device_y = stage.out(y);
  EXPECT_NE(device_x.data(), x.data());
  EXPECT_NE(device_y.data(), y.data());
  EXPECT_TRUE(std::isnan(device_y[1])) << "out() does not copy to the device";
  stage.for_each(3, Twice{device_x, device_y});
  EXPECT_EQ(y, unchanged) << "copied by finish() only";
  stage.finish();
  EXPECT_EQ(y, (std::vector<float>{2, 4, 6}));
}

TEST(Stage, InOutKeepsTheValues) {
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

TEST(Stage, UsesResidentArraysInPlace) {
  struct Increment {
    std::span<float> x;
    void operator()(std::size_t i) const { x[i] += 1; }
  };
  LoopDevice device;
  std::vector<float> x = {1, 2, 3, 4}, y(2, 7);
  auto memory = device.hold(x.size() * sizeof(float));
  device.to_device(memory.get(), x.data(), x.size() * sizeof(float));
  device.resident.add(x, memory);
  auto* const numbers = static_cast<float*>(memory.get());
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
  EXPECT_EQ(x[1], 2) << "unchanged";
  EXPECT_TRUE(std::isnan(x[2])) << "out of date";
  EXPECT_EQ(numbers[2], 4);
  memory.reset();
  x = {1, 2, 3, 4};
  Stage stage(device);
  stage.for_each(4, Increment{stage.in_out(x)});
  stage.finish();
  EXPECT_EQ(x, (std::vector<float>{2, 3, 4, 5})) << "copied as others when no longer resident";
}

TEST(Stage, CopiesNumbersOfAnyType) {
  struct Pair {
    std::int32_t first;
    float second;
  };
  struct Sum {
    std::span<const Pair> pairs;
    std::span<std::uint32_t> sums;
    void operator()(std::size_t i) const {
      sums[i] = static_cast<std::uint32_t>(static_cast<float>(pairs[i].first) + pairs[i].second);
    }
  };
  const std::vector<Pair> pairs = {{1, 2}, {3, 4}};
  std::vector<std::uint32_t> copied(2);
  std::vector<float> resident(3, 7);  // also holds integers, as in a workspace
  LoopDevice device;
  auto memory = device.hold(3 * sizeof(float));
  device.resident.add(resident, memory);
  const std::span<std::uint32_t> whole{reinterpret_cast<std::uint32_t*>(&resident[1]), 2};
  Stage stage(device);
  stage.for_each(2, Sum{stage.in(std::span(pairs)), stage.out(std::span(copied))});
  stage.for_each(2, Sum{stage.in(std::span(pairs)), stage.out(whole)});
  stage.finish();
  EXPECT_EQ(copied, (std::vector<std::uint32_t>{3, 7}));
  EXPECT_EQ(resident[0], 7);
  EXPECT_TRUE(std::isnan(resident[1])) << "out of date";
  EXPECT_EQ(static_cast<std::uint32_t*>(memory.get())[2], 7u);
}

TEST(Stage, ListsChosenIndicesInOrder) {
  struct OfThree {
    std::size_t rest;
    bool operator()(std::size_t i) const { return i % 3 == rest; }
  };
  LoopDevice device;
  for (const std::size_t n : {1u, 2u, 3u, 100u})
    for (const std::size_t rest : {0u, 2u, 3u}) {
      Stage stage(device);
      std::vector<std::uint32_t> list(n, 99), expected;
      for (std::size_t i = rest; i < n && rest < 3; i += 3)
        expected.push_back(static_cast<std::uint32_t>(i));
      const std::size_t count = stage.choose(n, OfThree{rest}, stage.out(std::span(list)));
      stage.finish();
      list.resize(count);
      EXPECT_EQ(list, expected) << n << ", " << rest;
    }
}

TEST(Stage, AcceptsEmptySpans) {
  LoopDevice device;
  Stage stage(device);
  EXPECT_TRUE(stage.in({}).empty());
  EXPECT_TRUE(stage.out({}).empty());
  EXPECT_TRUE(stage.in_out({}).empty());
  EXPECT_TRUE(stage.scratch<double>(0).empty());
  EXPECT_TRUE(stage.reduce(0, ValueTerm<float>{}).empty());
  stage.finish();
}

TEST(Stage, SumsEachTermOnce) {
  struct Index {
    double operator()(std::size_t i) const { return static_cast<double>(i); }
  };
  LoopDevice device;
  for (const std::size_t n : {1u, 4095u, 4096u, 4097u, 100000u}) {
    Stage stage(device);
    double sum = 7;
    stage.write_loss({stage.reduce(n, Index{})}, &sum);
    EXPECT_EQ(sum, 7) << "copied by finish() only";
    stage.finish();
    EXPECT_EQ(sum, 0.5 * static_cast<double>(n) * static_cast<double>(n - 1))
        << n;  // exact: integers
  }
}

TEST(Stage, AddsLossTerms) {
  LoopDevice device;
  Stage stage(device);
  const std::vector<float> numbers = {1, 2, 5};
  const auto sum = stage.reduce(3, ValueTerm<float>{stage.in(numbers)});
  double both = 0, none = 7;
  stage.write_loss({sum, 4}, {sum, 2, 3}, &both);
  stage.write_loss({}, &none);
  stage.finish();
  EXPECT_EQ(both, 2 + 12);
  EXPECT_EQ(none, 0);
}

}  // namespace
}  // namespace redrive::kernels
