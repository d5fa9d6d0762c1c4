// SPDX-License-Identifier: Apache-2.0
// A warp on the host computes the same as a GPU if the fragment layout is right. The layout is
// written down here a second time, number by number as in the PTX ISA ("Matrix Fragments for
// mma.m16n8k16 with floating point type"), and all results are compared with plain matrices.
#include "redrive/kernels/device/mma.h"

#include <array>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive::kernels {
namespace {

template <int kRows, int kColumns>
using Matrix = std::array<std::array<float, kColumns>, kRows>;

/// Position of number i = 0..7 of matrix A, or 0..3 of B and C. Two numbers of A and B share a
/// register, the first in the lower half.
MatrixPosition ptx_a(int lane, int i) {
  const int group = lane >> 2, in_group = lane % 4;
  return {(0 <= i && i < 2) || (4 <= i && i < 6) ? group : group + 8,
          i < 4 ? in_group * 2 + (i & 1) : in_group * 2 + (i & 1) + 8};
}
MatrixPosition ptx_b(int lane, int i) {
  const int group = lane >> 2, in_group = lane % 4;
  return {i < 2 ? in_group * 2 + (i & 1) : in_group * 2 + (i & 1) + 8, group};
}
MatrixPosition ptx_c(int lane, int i) {
  const int group = lane >> 2, in_group = lane % 4;
  return {i < 2 ? group : group + 8, in_group * 2 + (i & 1)};
}

/// Integers that bf16 represents, so that products and sums are exact; they depend on `stream` and
/// position.
template <int kRows, int kColumns>
Matrix<kRows, kColumns> whole_matrix(std::uint64_t stream) {
  Matrix<kRows, kColumns> m;
  for (int r = 0; r < kRows; ++r)
    for (int c = 0; c < kColumns; ++c)
      m[r][c] = static_cast<float>(
          static_cast<int>(random_bits(random_key(4, kStreamTest, stream), r * kColumns + c) %
                           255) -
          127);
  return m;
}

std::uint32_t exact_bits(float x) {
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(x);
  EXPECT_EQ(bits & 0xFFFFu, 0u) << x << " is not a bf16 number";
  return bits >> 16;
}
OperandA a_of(const Matrix<16, 16>& m) {
  OperandA a{};
  for (int lane = 0; lane < 32; ++lane)
    for (int i = 0; i < 8; ++i) {
      const MatrixPosition at = ptx_a(lane, i);
      a.lane[lane].at[i / 2] |= exact_bits(m[at.row][at.column]) << 16 * (i % 2);
    }
  return a;
}
OperandB b_of(const Matrix<16, 8>& m) {
  OperandB b{};
  for (int lane = 0; lane < 32; ++lane)
    for (int i = 0; i < 4; ++i) {
      const MatrixPosition at = ptx_b(lane, i);
      b.lane[lane].at[i / 2] |= exact_bits(m[at.row][at.column]) << 16 * (i % 2);
    }
  return b;
}
Sums sums_of(const Matrix<16, 8>& m) {
  Sums sums;
  for (int lane = 0; lane < 32; ++lane)
    for (int i = 0; i < 4; ++i) {
      const MatrixPosition at = ptx_c(lane, i);
      sums.lane[lane][i] = m[at.row][at.column];
    }
  return sums;
}
void expect_same(const OperandA& a, const OperandA& b) {
  for (int lane = 0; lane < 32; ++lane)
    for (int w = 0; w < 4; ++w)
      EXPECT_EQ(a.lane[lane].at[w], b.lane[lane].at[w]) << "lane " << lane << ", word " << w;
}

TEST(Mma, FragmentLayoutMatchesThePtxFigures) {
  // Corners of the PTX ISA's figures: positions of the fragments of A, B and C.
  const auto expect = [](MatrixPosition at, int row, int column) {
    EXPECT_EQ(at.row, row);
    EXPECT_EQ(at.column, column);
  };
  expect(ptx_a(0, 0), 0, 0);     // T0: {a0, a1}
  expect(ptx_a(3, 1), 0, 7);     // T3
  expect(ptx_a(0, 2), 8, 0);     // T0: {a2, a3}
  expect(ptx_a(0, 4), 0, 8);     // T0: {a4, a5}
  expect(ptx_a(31, 7), 15, 15);  // T31: {a6, a7}
  expect(ptx_b(0, 1), 1, 0);     // T0: {b0, b1}, one above the other
  expect(ptx_b(1, 0), 2, 0);     // T1
  expect(ptx_b(4, 2), 8, 1);     // T4: {b2, b3}
  expect(ptx_c(1, 0), 0, 2);     // T1: {c0, c1}
  expect(ptx_c(31, 3), 15, 7);   // T31: {c2, c3}
  for (int lane = 0; lane < 32; ++lane) {
    for (int i = 0; i < 8; ++i)
      expect(ptx_a(lane, i), position_in_a(lane, i / 2).row,
             position_in_a(lane, i / 2).column + i % 2);
    for (int i = 0; i < 4; ++i) {
      expect(ptx_b(lane, i), position_in_b(lane, i / 2).row + i % 2,
             position_in_b(lane, i / 2).column);
      expect(ptx_c(lane, i), position_in_sums(lane, i).row, position_in_sums(lane, i).column);
    }
  }
}

TEST(Mma, MultipliesMatrices) {
  const auto a = whole_matrix<16, 16>(1);
  const auto b = whole_matrix<16, 8>(2);
  auto c = whole_matrix<16, 8>(3);
  Sums sums = sums_of(c);
  multiply_add(sums, a_of(a), b_of(b));
  for (int m = 0; m < 16; ++m)
    for (int n = 0; n < 8; ++n)
      for (int k = 0; k < 16; ++k) c[m][n] += a[m][k] * b[k][n];
  const Sums expected = sums_of(c);
  for (int lane = 0; lane < 32; ++lane)
    for (int i = 0; i < 4; ++i)
      EXPECT_EQ(sums.lane[lane][i], expected.lane[lane][i]) << lane << ", " << i;
}

TEST(Mma, Transposes) {
  const auto m = whole_matrix<16, 16>(4);
  Matrix<16, 16> t;
  for (int r = 0; r < 16; ++r)
    for (int c = 0; c < 16; ++c) t[c][r] = m[r][c];
  expect_same(transposed(a_of(m)), a_of(t));
  expect_same(transposed(a_of(t)), a_of(m));
}

TEST(Mma, TransposedMatricesAreRightOperands) {
  const auto m = whole_matrix<16, 16>(5);
  for (const int half : {0, 1}) {
    Matrix<16, 8> columns;
    for (int r = 0; r < 16; ++r)
      for (int c = 0; c < 8; ++c) columns[r][c] = m[r][8 * half + c];
    const OperandB got = right_operand(transposed(a_of(m)), half), expected = b_of(columns);
    for (int lane = 0; lane < 32; ++lane)
      for (int w = 0; w < 2; ++w)
        EXPECT_EQ(got.lane[lane].at[w], expected.lane[lane].at[w]) << lane << ", " << w;
  }
}

TEST(Mma, SumsAreTheNextLeftOperand) {
  const auto m = whole_matrix<16, 16>(6);
  Sums16 sums;
  for (const int half : {0, 1}) {
    Matrix<16, 8> columns;
    for (int r = 0; r < 16; ++r)
      for (int c = 0; c < 8; ++c) columns[r][c] = m[r][8 * half + c];
    sums.half[half] = sums_of(columns);
  }
  expect_same(operand_of(sums), a_of(m));

  auto rectified = m, gated = m;
  const auto opened = whole_matrix<16, 16>(7);
  int closed = 0;
  for (int r = 0; r < 16; ++r)
    for (int c = 0; c < 16; ++c) {
      if (m[r][c] <= 0) rectified[r][c] = 0;
      if (opened[r][c] <= 0) gated[r][c] = 0, ++closed;
    }
  EXPECT_GT(closed, 64);
  Sums16 cut = sums;
  rectify(cut);
  expect_same(operand_of(cut), a_of(rectified));
  gate(sums, a_of(opened));
  expect_same(operand_of(sums), a_of(gated));
}

TEST(Mma, RoundsToTheNearestNumberOfBf16) {
  const auto rounded = [](float x) { return low_value(bf16_bits(x)); };
  EXPECT_EQ(rounded(1), 1);
  EXPECT_EQ(rounded(1 + 0x1p-8f), 1) << "ties to even";
  EXPECT_EQ(rounded(1 + 3 * 0x1p-8f), 1 + 0x1p-6f) << "ties to even";
  EXPECT_EQ(rounded(1 + 0x1.02p-8f), 1 + 0x1p-7f);
  EXPECT_EQ(rounded(-1 - 0x1.02p-8f), -1 - 0x1p-7f);
  EXPECT_EQ(rounded(0x1.FFp127f), INFINITY) << "half way to the number after the largest";
  EXPECT_EQ(rounded(-INFINITY), -INFINITY);
  EXPECT_EQ(bf16_bits(-0.0f), 0x8000u);
  for (const std::uint32_t bits : {0x7F800001u, 0x7FFFFFFFu, 0xFF800001u})
    EXPECT_TRUE(std::isnan(rounded(std::bit_cast<float>(bits)))) << bits;
  const std::uint32_t word = bf16_word(1, -2);
  EXPECT_EQ(low_value(word), 1);
  EXPECT_EQ(high_value(word), -2);
}

TEST(Mma, PropagatesNaN) {
  Sums16 sums = zero_sums();
  sums.half[1].lane[7][2] = std::numeric_limits<float>::quiet_NaN();
  rectify(sums);
  gate(sums, operand_of(sums));  // closed except at the NaN
  EXPECT_TRUE(std::isnan(sums.half[1].lane[7][2]));
  EXPECT_EQ(sums.half[0].lane[7][2], 0);
}

}  // namespace
}  // namespace redrive::kernels
