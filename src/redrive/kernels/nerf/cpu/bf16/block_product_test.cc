// SPDX-License-Identifier: Apache-2.0
// Compares block products with a double loop. The entries are small integers, so every sum is exact
// in fp32 in any order: |sum| <= 320 * 15 * 15 < 2^24.
#include <gtest/gtest.h>

#include "redrive/base/buffer.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/nerf/cpu/bf16/bf16_testing.h"

namespace redrive::kernels::bf16 {
namespace {

class BlockProductTest : public testing::Test {
 protected:
  void SetUp() override { SKIP_WITHOUT_BF16(); }

  /// Fills the operands for k_blocks blocks and `expected` [32][32] with their product.
  void make_operands(int k_blocks, std::uint64_t key) {
    a_ = Buffer<Bf16>(static_cast<std::size_t>(k_blocks) * kBlockSize);
    b_ = Buffer<Bf16>(static_cast<std::size_t>(k_blocks) * kBlockSize);
    const auto whole = [&](int k, int side, int index) {
      return static_cast<int>(random_bits(random_key(key, kStreamTest, side), k * 32 + index) %
                              31) -
             15;
    };
    for (double& x : expected_) x = 0;
    for (int k = 0; k < 32 * k_blocks; ++k) {
      for (int i = 0; i < 32; ++i) {
        a_[k / 32 * kBlockSize + row_form(i, k % 32)] = to_bf16(static_cast<float>(whole(k, 0, i)));
        b_[k / 32 * kBlockSize + pair_form(k % 32, i)] =
            to_bf16(static_cast<float>(whole(k, 1, i)));
        for (int j = 0; j < 32; ++j) expected_[i * 32 + j] += whole(k, 0, i) * whole(k, 1, j);
      }
    }
  }

  Buffer<Bf16> a_, b_;
  double expected_[32 * 32];
  Buffer<float> c_{kBlockSize};
};

TEST_F(BlockProductTest, ProductIsExactOnWholeNumbers) {
  for (const int k_blocks : {1, 2, 3, 4, 8, 10}) {
    make_operands(k_blocks, 7);
    multiply_blocks(a_.data(), b_.data(), k_blocks, nullptr, c_.data());
    for (int i = 0; i < 32; ++i) {
      for (int j = 0; j < 32; ++j)
        ASSERT_EQ(c_[c_form(i, j)], expected_[i * 32 + j]) << k_blocks << ' ' << i << ' ' << j;
    }
  }
}

TEST_F(BlockProductTest, BiasStartsTheSum) {
  make_operands(2, 8);
  Buffer<float> bias(kBiasTile);
  for (int i = 0; i < 32; ++i) {
    for (int j = 0; j < 16; ++j) bias[i * 16 + j] = static_cast<float>(1000 * i);
  }
  multiply_blocks(a_.data(), b_.data(), 2, bias.data(), c_.data());
  for (int i = 0; i < 32; ++i) {
    for (int j = 0; j < 32; ++j)
      ASSERT_EQ(c_[c_form(i, j)], expected_[i * 32 + j] + 1000 * i) << i << ' ' << j;
  }
}

TEST_F(BlockProductTest, AccumulateAddsOrOverwrites) {
  make_operands(3, 9);
  for (std::size_t i = 0; i < c_.size(); ++i) c_[i] = 12345;
  accumulate_blocks(a_.data(), b_.data(), 3, true, c_.data());
  accumulate_blocks(a_.data(), b_.data(), 3, false, c_.data());
  for (int i = 0; i < 32; ++i) {
    for (int j = 0; j < 32; ++j)
      ASSERT_EQ(c_[c_form(i, j)], 2 * expected_[i * 32 + j]) << i << ' ' << j;
  }
}

TEST_F(BlockProductTest, DenormalsCountAsZero) {
  make_operands(1, 10);
  for (std::size_t i = 0; i < a_.size(); ++i) a_[i] = 0x0040;  // 2^-127
  for (std::size_t i = 0; i < b_.size(); ++i) b_[i] = to_bf16(0x1p127f);
  multiply_blocks(a_.data(), b_.data(), 1, nullptr, c_.data());
  for (std::size_t i = 0; i < c_.size(); ++i) ASSERT_EQ(c_[i], 0.0f);
}

}  // namespace
}  // namespace redrive::kernels::bf16
