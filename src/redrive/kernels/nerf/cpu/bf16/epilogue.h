// SPDX-License-Identifier: Apache-2.0
// Epilogue of a finished fp32 block C: activation, mask, bias gradient, packing to bf16.
#pragma once

#include <cstring>

#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {
namespace {

enum class Epilogue {
  kReluKeep,        ///< forward, hidden layer: next, keep, mask
  kRelu,            ///< forward without a backward pass to follow: next only
  kMaskedGradient,  ///< backward into a ReLU layer: next, keep, d_bias
  kInputGradient,   ///< backward into the network's inputs: the C blocks themselves
  kHead             ///< forward, fp32 outputs: rgb and density
};

/// Outputs of a pass over blocks (output block ob, sample block n). Unused pointers are null.
struct PassOutput {
  Bf16* next = nullptr;  ///< [n_blocks][next_stride]
  int next_stride = 0;
  Bf16* keep = nullptr;           ///< [out_blocks][n_blocks]
  std::uint32_t* mask = nullptr;  ///< [out_blocks][n_blocks][32]
  float* d_bias = nullptr;        ///< [out_blocks][32]
  float* c = nullptr;             ///< [n_blocks][out_blocks] C blocks
  int c_stride = 0;               ///< out_blocks
  float* head = nullptr;  ///< row r of the only output block at head + r * head_stride, samples <
                          ///< head_samples
  std::ptrdiff_t head_stride = 0;
  int head_rows = 0, head_samples = 0;
};

constexpr bool is_masked(Epilogue kind) { return kind == Epilogue::kMaskedGradient; }
/// The rows of C are samples.
constexpr bool is_backward(Epilogue kind) {
  return is_masked(kind) || kind == Epilogue::kInputGradient;
}
constexpr bool keeps(Epilogue kind) { return is_masked(kind) || kind == Epilogue::kReluKeep; }

/// The block of `keep` that the epilogue of (output block ob, sample block n) writes, or null.
template <Epilogue kind>
REDRIVE_INLINE Bf16* keep_of(const PassOutput& output, int n_blocks, int ob, int n) {
  return keeps(kind) ? output.keep + (std::ptrdiff_t(ob) * n_blocks + n) * kBlockSize : nullptr;
}

/// The fp32 outputs of a block: row r in output.head, its first head_samples columns.
REDRIVE_INLINE void write_head(const PassOutput& output, int n, const float* c) {
  const __mmask16 valid0 = first_lanes(output.head_samples - n * kBlock),
                  valid1 = first_lanes(output.head_samples - n * kBlock - 16);
  float* head = output.head + std::ptrdiff_t(n) * kBlock;
  for (int r = 0; r < output.head_rows; ++r, head += output.head_stride) {
    const float* row = c + (r / 16) * 2 * kTileFloats + (r % 16) * 16;
    _mm512_mask_storeu_ps(head, valid0, _mm512_load_ps(row));
    _mm512_mask_storeu_ps(head + 16, valid1, _mm512_load_ps(row + kTileFloats));
  }
}

/// Packs a block of activations or of their gradients.
template <Epilogue kind>
REDRIVE_INLINE void pack_block(const PassOutput& output, int n_blocks, int ob, int n,
                               const float* c) {
  const std::ptrdiff_t at = std::ptrdiff_t(ob) * n_blocks + n;
  Bf16* next = output.next + (std::ptrdiff_t(n) * output.next_stride + ob) * kBlockSize;
  Bf16* keep = keep_of<kind>(output, n_blocks, ob, n);
  Bf16 *pairs = is_masked(kind) ? keep : next, *rows = is_masked(kind) ? next : keep;
  std::uint32_t* mask = keeps(kind) ? output.mask + at * kBlock : nullptr;
  alignas(64) std::uint32_t active[kBlock];  // per neuron, bit = sample
  const __m512 zero = _mm512_setzero_ps();
  __m512 sum0 = zero, sum1 = zero;
  for (int r = 0; r < kBlock; r += 2) {
    const float* row = c + (r / 16) * 2 * kTileFloats + (r % 16) * 16;
    __m512 even0 = _mm512_load_ps(row), even1 = _mm512_load_ps(row + kTileFloats);
    __m512 odd0 = _mm512_load_ps(row + 16), odd1 = _mm512_load_ps(row + kTileFloats + 16);
    if constexpr (is_masked(kind)) {
      const std::uint32_t even = mask[r], odd = mask[r + 1];
      even0 = _mm512_maskz_mov_ps(static_cast<__mmask16>(even), even0);
      even1 = _mm512_maskz_mov_ps(static_cast<__mmask16>(even >> 16), even1);
      odd0 = _mm512_maskz_mov_ps(static_cast<__mmask16>(odd), odd0);
      odd1 = _mm512_maskz_mov_ps(static_cast<__mmask16>(odd >> 16), odd1);
      sum0 = _mm512_add_ps(sum0, _mm512_add_ps(even0, odd0));
      sum1 = _mm512_add_ps(sum1, _mm512_add_ps(even1, odd1));
    } else {  // max(0, NaN) = NaN: the second operand is returned
      even0 = _mm512_max_ps(zero, even0);
      even1 = _mm512_max_ps(zero, even1);
      odd0 = _mm512_max_ps(zero, odd0);
      odd1 = _mm512_max_ps(zero, odd1);
    }
    if constexpr (keeps(kind)) {
      const __m512i even = to_bf16(even0, even1), odd = to_bf16(odd0, odd1);
      Bf16* packed = rows + (r / 16) * kTileSize + (r % 16) * kBlock;
      store(packed, even);
      store(packed + kBlock, odd);
      if constexpr (kind == Epilogue::kReluKeep) {  // active: > 0 as a signed 16-bit number, so
                                                    // neither 0 nor -0
        active[r] = _mm512_cmpgt_epi16_mask(even, _mm512_setzero_si512());
        active[r + 1] = _mm512_cmpgt_epi16_mask(odd, _mm512_setzero_si512());
      }
    }
    store(pairs + r / 2 * kBlock, to_bf16_pairs(even0, odd0));
    store(pairs + kTileSize + r / 2 * kBlock, to_bf16_pairs(even1, odd1));
  }
  if constexpr (is_masked(kind)) {
    float* d_bias = output.d_bias + std::ptrdiff_t(ob) * kBlock;
    _mm512_store_ps(d_bias, _mm512_add_ps(_mm512_load_ps(d_bias), sum0));
    _mm512_store_ps(d_bias + 16, _mm512_add_ps(_mm512_load_ps(d_bias + 16), sum1));
  }
  if constexpr (kind == Epilogue::kReluKeep) transpose_bits_32(active, mask);
}

template <Epilogue kind>
REDRIVE_INLINE void finish_block(const PassOutput& output, int n_blocks, int ob, int n,
                                 const float* c) {
  if constexpr (kind == Epilogue::kHead) {
    write_head(output, n, c);
  } else if constexpr (kind == Epilogue::kInputGradient) {
    std::memcpy(output.c + (std::ptrdiff_t(n) * output.c_stride + ob) * kBlockSize, c,
                kBlockSize * sizeof(float));
  } else {
    pack_block<kind>(output, n_blocks, ob, n, c);
  }
}

}  // namespace
}  // namespace redrive::kernels::bf16
