// SPDX-License-Identifier: Apache-2.0
// Uses small integers, exact in bf16 and with exact sums in float. Memory is initialised with NaN,
// which shows numbers that a functor does not write.
#include "redrive/kernels/device/tensor_tiles.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/kernels/device/tensor_testing.h"

namespace redrive::kernels {
namespace {

TEST(TensorTiles, HoldNumbersInBothForms) {
  for (const auto& [samples, columns] :
       {std::pair<std::size_t, std::size_t>{1, 1}, {16, 16}, {37, 63}, {300, 3}}) {
    TestActivations tiles(samples, 16 + columns);
    const auto numbers = small_numbers(samples * columns, 1);
    tiles.put(numbers, samples, columns, 1);
    for (std::size_t s = 0; s < tensor_tiles(samples) * 16; ++s)
      for (std::size_t c = 0; c < tensor_tiles(columns) * 16; ++c) {
        const float expected = s < samples && c < columns ? numbers[s * columns + c] : 0;
        ASSERT_EQ(tiles.at(s, 16 + c), expected) << s << ", " << c;
        ASSERT_EQ(tiles.at_in_columns(s, 16 + c), expected) << s << ", " << c;
      }
    EXPECT_TRUE(std::isnan(tiles.at(0, 0))) << "outside the requested tiles";
  }
}

TEST(TensorTiles, PackWeights) {
  const std::size_t outputs = 19, inputs = 21, row = 30;
  const auto weights = small_numbers(outputs * row, 2);
  for (const bool back : {false, true}) {
    PackTensorWeights pack{.weight = weights.data(),
                           .outputs = outputs,
                           .inputs = inputs,
                           .row = row,
                           .back = back,
                           .first_k = 1,
                           .tiles_of_k = 4};
    EXPECT_EQ(pack.words(), 2u * 4 * 64);
    std::vector<LanePair> packed(4 * 4 * kLanes, LanePair{{~0u, ~0u}});
    pack.to = packed.data();
    for (std::size_t i = 0; i < pack.words(); ++i) pack(i);
    for (std::size_t n = 0; n < 32; ++n)
      for (std::size_t k = 0; k < 64; ++k) {
        const OperandB tile = load_b(&packed[(n / 8 * 4 + k / 16) * kLanes]);
        float got = INFINITY;
        for (int lane = 0; lane < kLanes; ++lane)
          for (int w = 0; w < 2; ++w) {
            const MatrixPosition at = position_in_b(lane, w);
            if (static_cast<std::size_t>(at.column) != n % 8 ||
                static_cast<std::size_t>(at.row) != k % 16 / 2 * 2)
              continue;
            got = k % 2 == 0 ? low_value(tile.lane[lane].at[w]) : high_value(tile.lane[lane].at[w]);
          }
        if (k < 16 || k >= 48) {
          EXPECT_TRUE(std::isnan(got)) << "belongs to another layer";
          continue;
        }
        const std::size_t o = back ? k - 16 : n, i = back ? n : k - 16;
        ASSERT_EQ(got, o < outputs && i < inputs ? weights[o * row + i] : 0) << o << ", " << i;
      }
  }
}

TEST(TensorTiles, RunFunctorsInTurn) {
  struct Write {
    int* to;
    void operator()(std::size_t i) const { to[i] += 1 + static_cast<int>(i); }
  };
  int to[3][4]{};
  ConcatenatedFunctors<Write, 3> all;
  EXPECT_EQ(all.size(), 0u);
  all.add({to[0]}, 4);
  all.add({to[1]}, 0);
  all.add({to[2]}, 2);
  ASSERT_EQ(all.size(), 6u);
  for (std::size_t i = 0; i < all.size(); ++i) all(i);
  const int expected[3][4] = {{1, 2, 3, 4}, {0, 0, 0, 0}, {1, 2, 0, 0}};
  for (int f = 0; f < 3; ++f)
    for (int i = 0; i < 4; ++i) EXPECT_EQ(to[f][i], expected[f][i]);
}

TEST(TensorTiles, WeightBackwardAcrossSlices) {
  for (const std::size_t samples : {std::size_t{1}, kSamplesPerSlice, 2 * kSamplesPerSlice + 37})
    for (const auto& [outputs, inputs] :
         {std::pair<std::size_t, std::size_t>{1, 1}, {3, 64}, {40, 70}, {64, 32}})
      for (const bool has_bias : {false, true}) {
        const auto d_y = small_numbers(samples * outputs, 3),
                   x = small_numbers(samples * inputs, 4);
        TestActivations device_d(samples, 16 + outputs), device_x(samples, inputs);
        device_d.put(d_y, samples, outputs, 1);
        device_x.put(x, samples, inputs);
        const std::size_t size = outputs * (inputs + has_bias),
                          row = size + 3;  // followed by another layer's
        std::vector<float> partial(slices_of(samples) * row, 0.25f);
        TensorWeightBackward backward{samples,
                                      outputs,
                                      inputs,
                                      has_bias,
                                      device_d.activations,
                                      1,
                                      device_x.activations,
                                      partial.data(),
                                      row};
        run_warps(backward);
        std::vector<float> gradients(row), expected(row);
        ReduceSlices add{slices_of(samples), row, partial.data(), gradients.data()};
        for (std::size_t i = 0; i < row; ++i) add(i);
        for (std::size_t i = size; i < row; ++i)
          expected[i] = 0.25f * static_cast<float>(slices_of(samples));
        for (std::size_t s = 0; s < samples; ++s)
          for (std::size_t o = 0; o < outputs; ++o) {
            for (std::size_t i = 0; i < inputs; ++i)
              expected[o * inputs + i] += d_y[s * outputs + o] * x[s * inputs + i];
            if (has_bias) expected[outputs * inputs + o] += d_y[s * outputs + o];
          }
        ASSERT_EQ(gradients, expected) << samples << " samples: " << outputs << " x " << inputs;
      }
}

}  // namespace
}  // namespace redrive::kernels
