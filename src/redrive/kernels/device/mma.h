// SPDX-License-Identifier: Apache-2.0
// Products of small matrices by a warp on tensor cores: operands in bf16, sums in fp32. A warp has
// 32 lanes, and each holds a fragment of every matrix. The code is written once: on a GPU a thread
// has the registers of its own lane, on the host those of all 32, so that the layout is tested on
// every machine. It is the layout of mma.m16n8k16 for bf16 (NVIDIA, "PTX ISA", warp-level matrix
// instructions), with group = lane / 4 and thread = lane % 4 (groupID and threadID_in_group there):
//
// - OperandA, 16 x 16: word w has row group + 8 (w % 2), columns 2 thread + 8 (w / 2) and the next,
//   the first in the lower half.
// - OperandB, 16 x 8: word w has rows 2 thread + 8 w and the next, column group.
// - Sums, 16 x 8: number i has row group + 8 (i / 2), column 2 thread + i % 2.
//
// Two adjacent Sums have the layout of an OperandA, so a layer's outputs are the next layer's
// inputs in the same registers (operand_of). The words of a transposed OperandA have the layout of
// two OperandBs.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>

#include "redrive/base/host_device.h"
#include "redrive/field/activation.h"

#ifdef __CUDA_ARCH__
#define REDRIVE_UNROLL _Pragma("unroll")  // otherwise arrays would be in memory
#else
#define REDRIVE_UNROLL
#endif

namespace redrive::kernels {

constexpr int kLanes = 32;
#ifdef __CUDA_ARCH__
constexpr int kLanesHere = 1;
__device__ inline int lane_of(int) { return static_cast<int>(threadIdx.x % kLanes); }
#else
constexpr int kLanesHere = kLanes;  ///< lanes whose registers the matrices below hold
constexpr int lane_of(int here) { return here; }
#endif

/// Return the lower and the upper bf16 number of a word.
REDRIVE_HD inline float low_value(std::uint32_t word) { return std::bit_cast<float>(word << 16); }
REDRIVE_HD inline float high_value(std::uint32_t word) {
  return std::bit_cast<float>(word & 0xFFFF0000u);
}

/// Rounds to the nearest bf16 number, ties to even; NaN stays NaN.
REDRIVE_HD inline std::uint32_t bf16_bits(float x) {
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(x);
  if ((bits & 0x7FFFFFFFu) > 0x7F800000u) return bits >> 16 | 0x40u;
  return (bits + 0x7FFFu + (bits >> 16 & 1u)) >> 16;
}
REDRIVE_HD inline std::uint32_t bf16_word(float low, float high) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  std::uint32_t word;
  asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(word) : "f"(high), "f"(low));
  return word;
#else
  return bf16_bits(low) | bf16_bits(high) << 16;
#endif
}

/// A lane's four words: 16 bytes, one load.
struct alignas(16) LaneWords {
  std::uint32_t at[4];
};
struct alignas(8) LanePair {
  std::uint32_t at[2];
};

struct OperandA {
  LaneWords lane[kLanesHere];
};
struct OperandB {
  LanePair lane[kLanesHere];
};
struct Sums {
  float lane[kLanesHere][4];
};

struct MatrixPosition {
  int row, column;
};
/// Position of the lower half of word w, whose upper half is in the next column or row; or of
/// number i.
REDRIVE_HD inline MatrixPosition position_in_a(int lane, int w) {
  return {lane / 4 + 8 * (w % 2), 2 * (lane % 4) + 8 * (w / 2)};
}
REDRIVE_HD inline MatrixPosition position_in_b(int lane, int w) {
  return {2 * (lane % 4) + 8 * w, lane / 4};
}  // the upper half is one row below
REDRIVE_HD inline MatrixPosition position_in_sums(int lane, int i) {
  return {lane / 4 + 8 * (i / 2), 2 * (lane % 4) + i % 2};
}

/// sums += a b
REDRIVE_HD inline void multiply_add(Sums& sums, const OperandA& a, const OperandB& b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  float* const c = sums.lane[0];
  const std::uint32_t *const x = a.lane[0].at, *const y = b.lane[0].at;
  asm volatile(
      "mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, "
      "{%8, %9}, {%0, %1, %2, "
      "%3};"
      : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
      : "r"(x[0]), "r"(x[1]), "r"(x[2]), "r"(x[3]), "r"(y[0]), "r"(y[1]));
#elif defined(__CUDA_ARCH__)
  __trap();  // callers check Device::has_tensor_cores
#else
  float left[16][16], right[16][8], c[16][8];
  for (int lane = 0; lane < kLanes; ++lane) {
    for (int w = 0; w < 4; ++w) {
      const MatrixPosition at = position_in_a(lane, w);
      left[at.row][at.column] = low_value(a.lane[lane].at[w]);
      left[at.row][at.column + 1] = high_value(a.lane[lane].at[w]);
    }
    for (int w = 0; w < 2; ++w) {
      const MatrixPosition at = position_in_b(lane, w);
      right[at.row][at.column] = low_value(b.lane[lane].at[w]);
      right[at.row + 1][at.column] = high_value(b.lane[lane].at[w]);
    }
    for (int i = 0; i < 4; ++i) {
      const MatrixPosition at = position_in_sums(lane, i);
      c[at.row][at.column] = sums.lane[lane][i];
    }
  }
  for (int m = 0; m < 16; ++m)
    for (int k = 0; k < 16; ++k)
      for (int n = 0; n < 8; ++n) c[m][n] += left[m][k] * right[k][n];
  for (int lane = 0; lane < kLanes; ++lane)
    for (int i = 0; i < 4; ++i) {
      const MatrixPosition at = position_in_sums(lane, i);
      sums.lane[lane][i] = c[at.row][at.column];
    }
#endif
}

/// Transposes a matrix: movmatrix transposes each of the four blocks of 8 x 8, and the off-diagonal
/// blocks are exchanged.
REDRIVE_HD inline OperandA transposed(const OperandA& a) {
  OperandA out;
  REDRIVE_UNROLL
  for (int w = 0; w < 4; ++w) {
    const int from = w == 1 ? 2 : w == 2 ? 1 : w;
#ifdef __CUDA_ARCH__
    asm volatile("movmatrix.sync.aligned.m8n8.trans.b16 %0, %1;"
                 : "=r"(out.lane[0].at[w])
                 : "r"(a.lane[0].at[from]));
#else
    for (int lane = 0; lane < kLanes; ++lane) {
      const int group = lane / 4,
                thread = lane % 4;  // has (2 thread, group) and (2 thread + 1, group) of the block
      const auto half = [&](int row) {
        return a.lane[4 * row + group / 2].at[from] >> 16 * (group % 2) & 0xFFFFu;
      };
      out.lane[lane].at[w] = half(2 * thread) | half(2 * thread + 1) << 16;
    }
#endif
  }
  return out;
}

/// Returns eight columns of a transposed matrix as a right operand: of x [16 k, 16 columns] in
/// `of_x_transposed`, columns 8 half to 8 half + 7.
REDRIVE_HD inline OperandB right_operand(const OperandA& of_x_transposed, int half) {
  OperandB b;
  for (int here = 0; here < kLanesHere; ++here)
    b.lane[here] = {{of_x_transposed.lane[here].at[half], of_x_transposed.lane[here].at[half + 2]}};
  return b;
}

/// 16 x 16 sums, the left half first.
struct Sums16 {
  Sums half[2];
};

REDRIVE_HD inline Sums16 zero_sums() {
  Sums16 sums;
  REDRIVE_UNROLL
  for (Sums& half : sums.half)
    for (auto& lane : half.lane)
      for (float& x : lane) x = 0;
  return sums;
}

/// Rounds to bf16: word w has numbers 0, 1 (w even) or 2, 3 of half w / 2.
REDRIVE_HD inline OperandA operand_of(const Sums16& sums) {
  OperandA out;
  for (int here = 0; here < kLanesHere; ++here) {
    REDRIVE_UNROLL
    for (int w = 0; w < 4; ++w) {
      const float* const from = sums.half[w / 2].lane[here] + 2 * (w % 2);
      out.lane[here].at[w] = bf16_word(from[0], from[1]);
    }
  }
  return out;
}

REDRIVE_HD inline void rectify(Sums16& sums) {
  REDRIVE_UNROLL
  for (Sums& half : sums.half)
    for (auto& lane : half.lane)
      for (float& x : lane) x = relu(x);
}

/// Sets derivatives to 0 where the ReLU that returned `opened`, in the same layout, is closed.
REDRIVE_HD inline void gate(Sums16& sums, const OperandA& opened) {
  for (int here = 0; here < kLanesHere; ++here) {
    REDRIVE_UNROLL
    for (int w = 0; w < 4; ++w) {
      float* const x = sums.half[w / 2].lane[here] + 2 * (w % 2);
      if (low_value(opened.lane[here].at[w]) <= 0) x[0] = 0;
      if (high_value(opened.lane[here].at[w]) <= 0) x[1] = 0;
    }
  }
}

}  // namespace redrive::kernels
