// SPDX-License-Identifier: Apache-2.0
// Uses small integers, whose products and sums are exact.
#include "redrive/kernels/device/tensor_product.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/kernels/device/tensor_testing.h"

namespace redrive::kernels {
namespace {

struct ProductCase {
  std::size_t samples, outputs, inputs;
};
const ProductCase kProducts[] = {
    {1, 1, 1}, {16, 64, 16}, {37, 3, 63}, {70, 144, 40}, {130, 80, 32}};

std::vector<LanePair> packed_weights(PackTensorWeights pack) {
  pack.tiles_of_k = pack.own_tiles_of_k();
  std::vector<LanePair> packed(pack.words() / 2);
  pack.to = packed.data();
  for (std::size_t i = 0; i < pack.words(); ++i) pack(i);
  return packed;
}

TEST(TensorProduct, Forward) {
  for (const auto& [samples, outputs, inputs] : kProducts)
    for (const bool whole : {false, true}) {  // bias and ReLU, to tiles; else adds to numbers
      const auto x = small_numbers(samples * inputs, 1), w = small_numbers(outputs * inputs, 2),
                 b = small_numbers(outputs, 3);
      const auto packed = packed_weights(
          {.weight = w.data(), .outputs = outputs, .inputs = inputs, .row = inputs, .back = false});
      TestActivations device_x(samples, inputs), y(samples, outputs);
      device_x.put(x, samples, inputs);
      std::vector<float> numbers(samples * outputs, 0.5f);
      TensorProduct product{.samples = samples,
                            .columns = outputs,
                            .tiles_of_k = tensor_tiles(inputs),
                            .x = device_x.activations,
                            .weights = packed.data()};
      if (whole) {
        product.bias = b.data();
        product.has_relu = true;
        product.y = y.activations;
      } else {
        product.numbers = {numbers.data(), 1, samples};  // channels first
        product.adds = true;
      }
      run_warps(product);
      for (std::size_t s = 0; s < samples; ++s)
        for (std::size_t o = 0; o < outputs; ++o) {
          float expected = whole ? b[o] : 0.5f;
          for (std::size_t i = 0; i < inputs; ++i)
            expected += w[o * inputs + i] * x[s * inputs + i];
          if (!whole) {
            ASSERT_EQ(numbers[o * samples + s], expected) << s << ", " << o;
            continue;
          }
          expected = low_value(bf16_bits(std::max(expected, 0.0f)));
          ASSERT_EQ(y.at(s, o), expected) << s << ", " << o;
          ASSERT_EQ(y.at_in_columns(s, o), expected) << s << ", " << o;
        }
    }
}

TEST(TensorProduct, InputBackward) {
  for (const auto& [samples, outputs, inputs] : kProducts) {
    const auto d_y = small_numbers(samples * outputs, 4), w = small_numbers(outputs * inputs, 5),
               opened = small_numbers(samples * inputs, 6);
    const auto packed = packed_weights(
        {.weight = w.data(), .outputs = outputs, .inputs = inputs, .row = inputs, .back = true});
    TestActivations device_d(samples, outputs), device_opened(samples, inputs),
        d_x(samples, inputs);
    device_d.put(d_y, samples, outputs);
    device_opened.put(opened, samples, inputs);
    run_warps(TensorProduct{.samples = samples,
                            .columns = inputs,
                            .tiles_of_k = tensor_tiles(outputs),
                            .x = device_d.activations,
                            .weights = packed.data(),
                            .opened = device_opened.activations,
                            .y = d_x.activations});
    for (std::size_t s = 0; s < tensor_tiles(samples) * 16; ++s)
      for (std::size_t i = 0; i < inputs; ++i) {
        float expected = 0;
        if (s < samples && opened[s * inputs + i] > 0)
          for (std::size_t o = 0; o < outputs; ++o)
            expected += w[o * inputs + i] * d_y[s * outputs + o];
        expected = low_value(bf16_bits(expected));
        ASSERT_EQ(d_x.at(s, i), expected) << s << ", " << i;
        ASSERT_EQ(d_x.at_in_columns(s, i), expected) << s << ", " << i;
      }
  }
}

}  // namespace
}  // namespace redrive::kernels
