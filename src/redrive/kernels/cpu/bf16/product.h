// SPDX-License-Identifier: Apache-2.0
// Operands of an engine's products, and the prefetches of a pass.
#pragma once

#include "redrive/kernels/cpu/bf16/plan.h"
#include "redrive/kernels/cpu/bf16/vector.h"

namespace redrive::kernels::bf16 {
namespace {

/// C = sum of k0 block products a0[k] b0[k], then of k1 at a1, b1 (the concatenated encoding).
struct Product {
  const Bf16 *a0 = nullptr, *b0 = nullptr;
  int k0 = 0;
  const Bf16 *a1 = nullptr, *b1 = nullptr;
  int k1 = 0;
};

constexpr int kLine = 64;

/// Prefetches during a pass over blocks: a few lines per product of the weights or gradients of the
/// next pass (to L2), and the "keep" block that the epilogue of this product will write (to L1, for
/// writing).
struct Prefetch {
  const char* stream = nullptr;
  std::ptrdiff_t stream_left = 0;
  const char* written = nullptr;

  REDRIVE_INLINE void advance_stream() {
    constexpr int kLines = 8;
    if (stream_left <= 0) return;
    for (int i = 0; i < kLines; ++i) _mm_prefetch(stream + i * kLine, _MM_HINT_T1);
    stream += kLines * kLine;
    stream_left -= kLines * kLine;
  }
  REDRIVE_INLINE void prepare_write(int first_line, int lines) const {
    if (!written) return;
    for (int i = first_line; i < first_line + lines; ++i)
      _mm_prefetch(written + i * kLine, _MM_HINT_ET0);
  }
};

/// For sums of weight gradients: the next C block (4 KiB, to L1) and the next left panel (k_blocks
/// x 2 KiB, to L2; or null).
struct PanelPrefetch {
  const char* next_c = nullptr;
  const char* next_a = nullptr;

  REDRIVE_INLINE void step(int k) const {
    constexpr int kLinesOfC = 4096 / kLine / kWeightGradientBlocks, kLinesOfA = 2048 / kLine;
    for (int i = 0; i < kLinesOfC; ++i)
      _mm_prefetch(next_c + (k * kLinesOfC + i) * kLine, _MM_HINT_T0);
    if (!next_a) return;
    for (int i = 0; i < kLinesOfA; ++i)
      _mm_prefetch(next_a + (k * kLinesOfA + i) * kLine, _MM_HINT_T1);
  }
};

}  // namespace
}  // namespace redrive::kernels::bf16
