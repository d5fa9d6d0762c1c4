// SPDX-License-Identifier: Apache-2.0
// Uses small integers, whose products and sums are exact in float: any order, tile and slice gives
// the same result.
#include "redrive/kernels/device/fp32_layer_functors.h"

#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/kernels/device/fp32_layers.h"
#include "redrive/kernels/device/loop_device.h"

namespace redrive::kernels {
namespace {

std::vector<float> whole_numbers(std::size_t n, std::uint64_t stream) {
  std::vector<float> out(n);
  for (std::size_t i = 0; i < n; ++i)
    out[i] = static_cast<float>(
        static_cast<int>(random_bits(random_key(3, kStreamTest, stream), i) % 7) - 3);
  return out;
}

struct Shape {
  std::size_t samples, outputs, inputs;
};
const Shape kShapes[] = {{1, 1, 1}, {3, 4, 5}, {4, 8, 4}, {9, 3, 63}, {130, 17, 2}};

template <class Tiles>
void run(const Tiles& layer) {
  for (std::size_t tile = 0; tile < layer.tiles(); ++tile) layer(tile);
}

TEST(LayerFunctors, Forward) {
  for (const auto& [samples, outputs, inputs] : kShapes)
    for (const bool whole : {false, true}) {  // with a bias and a ReLU
      const std::size_t row = inputs + 3;     // rows of x have more numbers than the layer's inputs
      const auto x = whole_numbers(samples * row, 1), w = whole_numbers(outputs * inputs, 2),
                 b = whole_numbers(outputs, 3);
      std::vector<float> y(samples * outputs, NAN);  // channels first, as raw
      run(LayerForward{samples,
                       outputs,
                       inputs,
                       w.data(),
                       whole ? b.data() : nullptr,
                       whole,
                       {x.data(), row},
                       {y.data(), 1, samples}});
      for (std::size_t s = 0; s < samples; ++s)
        for (std::size_t o = 0; o < outputs; ++o) {
          float expected = whole ? b[o] : 0;
          for (std::size_t i = 0; i < inputs; ++i) expected += w[o * inputs + i] * x[s * row + i];
          EXPECT_EQ(y[o * samples + s], whole && expected < 0 ? 0 : expected) << s << ", " << o;
        }
    }
}

TEST(LayerFunctors, InputBackward) {
  for (const auto& [samples, outputs, inputs] : kShapes)
    for (const bool whole : {false, true}) {  // adds to d_x, then applies the ReLU's mask
      const std::size_t columns = whole ? (inputs + 1) / 2 : inputs, row = columns + 1;
      const auto d_y = whole_numbers(samples * outputs, 4), w = whole_numbers(outputs * inputs, 5),
                 x = whole_numbers(samples * inputs, 6), before = whole_numbers(samples * row, 7);
      std::vector<float> d_x = before;
      run(LayerInputBackward{samples,
                             outputs,
                             inputs,
                             columns,
                             w.data(),
                             whole,
                             {d_y.data(), outputs},
                             {whole ? x.data() : nullptr, inputs},
                             {d_x.data(), row}});
      for (std::size_t s = 0; s < samples; ++s) {
        for (std::size_t i = 0; i < columns; ++i) {
          float expected = whole ? before[s * row + i] : 0;
          for (std::size_t o = 0; o < outputs; ++o)
            expected += w[o * inputs + i] * d_y[s * outputs + o];
          EXPECT_EQ(d_x[s * row + i], whole && x[s * inputs + i] <= 0 ? 0 : expected)
              << s << ", " << i;
        }
        EXPECT_EQ(d_x[s * row + columns], before[s * row + columns])
            << "outside the requested columns";
      }
    }
}

TEST(LayerFunctors, WeightBackwardAcrossSlices) {
  for (const std::size_t samples : {std::size_t{1}, kSamplesPerSlice, 2 * kSamplesPerSlice + 37})
    for (const auto& [unused, outputs, inputs] : kShapes)
      for (const bool has_bias : {false, true}) {
        const auto d_y = whole_numbers(samples * outputs, 8),
                   x = whole_numbers(samples * inputs, 9);
        LayerWeightBackward backward{
            samples, outputs, inputs, has_bias, {d_y.data(), outputs}, {x.data(), inputs}};
        std::vector<float> partial(slices_of(samples) * backward.size(), NAN),
            gradients(backward.size(), 2.0f);
        backward.partial = partial.data();
        run(backward);
        const ReduceSlices add{slices_of(samples), backward.size(), partial.data(),
                               gradients.data()};
        for (std::size_t i = 0; i < gradients.size(); ++i) add(i);
        for (std::size_t o = 0; o < outputs; ++o) {
          float of_bias = 2;
          for (std::size_t s = 0; s < samples; ++s) of_bias += d_y[s * outputs + o];
          if (has_bias) {
            EXPECT_EQ(gradients[outputs * inputs + o], of_bias) << o;
          }
          for (std::size_t i = 0; i < inputs; ++i) {
            float expected = 2;
            for (std::size_t s = 0; s < samples; ++s)
              expected += d_y[s * outputs + o] * x[s * inputs + i];
            ASSERT_EQ(gradients[o * inputs + i], expected) << samples << ": " << o << ", " << i;
          }
        }
      }
}

TEST(LayerFunctors, AddsSlicesInGroups) {
  LoopDevice device;
  for (const std::size_t slices : {1u, 31u, 32u, 33u, 64u, 100u}) {
    Stage stage(device);
    const std::size_t size = 5;
    std::vector<float> partial = whole_numbers(slices * size, 10), gradients(size, 2.0f),
                       expected(size, 2.0f);
    for (std::size_t i = 0; i < partial.size(); ++i) expected[i % size] += partial[i];
    reduce_slices(stage, slices, size, partial.data(), gradients.data());
    EXPECT_EQ(gradients, expected) << slices;
  }
}

}  // namespace
}  // namespace redrive::kernels
