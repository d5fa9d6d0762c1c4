// SPDX-License-Identifier: Apache-2.0
// Epilogue of a finished fp32 block C, run between two products: activation, mask, bias gradient,
// packing to bf16. It runs a few rows at a time, so that an engine can interleave it with the
// products of the next block: on AMX the vector units and the tiles would otherwise wait for each
// other (390 -> 277 ns per block of k = 256).
#pragma once

#include "redrive/kernels/cpu/bf16/plan.h"
#include "redrive/kernels/cpu/bf16/vector.h"

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

/// The epilogue of the block computed last, to be run while the next one is computed.
template <Epilogue kind>
class Pending {
 public:
  static constexpr bool kActivates = kind == Epilogue::kReluKeep || kind == Epilogue::kRelu;
  static constexpr bool kMasked = kind == Epilogue::kMaskedGradient;
  static constexpr bool kBackward =
      kMasked || kind == Epilogue::kInputGradient;  ///< rows are samples
  static constexpr bool kKeeps = kMasked || kind == Epilogue::kReluKeep;

  Pending(const PassOutput& output, int n_blocks, const float* c)
      : output_(output), n_blocks_(n_blocks), c_(c) {}

  bool exists() const { return exists_; }

  /// The cache lines that the next block's epilogue writes first.
  REDRIVE_INLINE const Bf16* keep_of(int ob, int n) const {
    return kKeeps ? output_.keep + (std::ptrdiff_t(ob) * n_blocks_ + n) * kBlockSize : nullptr;
  }

  REDRIVE_INLINE void set(int ob, int n) {
    exists_ = true;
    if constexpr (kind == Epilogue::kHead) {
      head_ = output_.head + std::ptrdiff_t(n) * kBlock;
      valid0_ = first_lanes(output_.head_samples - n * kBlock);
      valid1_ = first_lanes(output_.head_samples - n * kBlock - 16);
    } else if constexpr (kind == Epilogue::kInputGradient) {
      to_ = output_.c + (std::ptrdiff_t(n) * output_.c_stride + ob) * kBlockSize;
    } else {
      Bf16* next = output_.next + (std::ptrdiff_t(n) * output_.next_stride + ob) * kBlockSize;
      Bf16* keep = const_cast<Bf16*>(keep_of(ob, n));
      pairs_ = kMasked ? keep : next;
      rows_ = kMasked ? next : keep;
      if constexpr (kKeeps) {
        mask_ = output_.mask + (std::ptrdiff_t(ob) * n_blocks_ + n) * kBlock;
      }
      if constexpr (kMasked) d_bias_ = output_.d_bias + std::ptrdiff_t(ob) * kBlock;
    }
  }

  /// Rows first .. first + count of the block; count even; in ascending order, 32 in all.
  REDRIVE_INLINE void rows(int first, int count) {
    const __m512 zero = _mm512_setzero_ps();
    __m512 sum0 = zero, sum1 = zero;
    for (int r = first; r < first + count; r += 2) {
      const float* c = c_ + (r / 16) * 2 * kTileFloats + (r % 16) * 16;
      __m512 even0 = _mm512_load_ps(c), even1 = _mm512_load_ps(c + kTileFloats);
      __m512 odd0 = _mm512_load_ps(c + 16), odd1 = _mm512_load_ps(c + kTileFloats + 16);
      if constexpr (kind == Epilogue::kHead) {
        store_head(r, even0, even1);
        store_head(r + 1, odd0, odd1);
        continue;
      }
      if constexpr (kind == Epilogue::kInputGradient) {
        float* to = to_ + (c - c_);
        _mm512_store_ps(to, even0);
        _mm512_store_ps(to + 16, odd0);
        _mm512_store_ps(to + kTileFloats, even1);
        _mm512_store_ps(to + kTileFloats + 16, odd1);
        continue;
      }
      if constexpr (kActivates) {  // max(0, NaN) = NaN: the second operand is returned
        even0 = _mm512_max_ps(zero, even0);
        even1 = _mm512_max_ps(zero, even1);
        odd0 = _mm512_max_ps(zero, odd0);
        odd1 = _mm512_max_ps(zero, odd1);
      }
      if constexpr (kMasked) {
        const std::uint32_t even = mask_[r], odd = mask_[r + 1];
        even0 = _mm512_maskz_mov_ps(static_cast<__mmask16>(even), even0);
        even1 = _mm512_maskz_mov_ps(static_cast<__mmask16>(even >> 16), even1);
        odd0 = _mm512_maskz_mov_ps(static_cast<__mmask16>(odd), odd0);
        odd1 = _mm512_maskz_mov_ps(static_cast<__mmask16>(odd >> 16), odd1);
      }
      if constexpr (kMasked) {
        sum0 = _mm512_add_ps(sum0, _mm512_add_ps(even0, odd0));
        sum1 = _mm512_add_ps(sum1, _mm512_add_ps(even1, odd1));
      }
      if constexpr (kKeeps) {
        const __m512i even = to_bf16(even0, even1), odd = to_bf16(odd0, odd1);
        Bf16* row = rows_ + (r / 16) * kTileSize + (r % 16) * kBlock;
        store(row, even);
        store(row + kBlock, odd);
        if constexpr (kind == Epilogue::kReluKeep) {  // active: > 0 as a signed 16-bit number, so
                                                      // neither 0 nor -0
          active_[r] = _mm512_cmpgt_epi16_mask(even, _mm512_setzero_si512());
          active_[r + 1] = _mm512_cmpgt_epi16_mask(odd, _mm512_setzero_si512());
        }
      }
      store(pairs_ + r / 2 * kBlock, to_bf16_pairs(even0, odd0));
      store(pairs_ + kTileSize + r / 2 * kBlock, to_bf16_pairs(even1, odd1));
    }
    if constexpr (kMasked) {
      _mm512_store_ps(d_bias_, _mm512_add_ps(_mm512_load_ps(d_bias_), sum0));
      _mm512_store_ps(d_bias_ + 16, _mm512_add_ps(_mm512_load_ps(d_bias_ + 16), sum1));
    }
    if constexpr (kind == Epilogue::kReluKeep) {
      if (first + count == kBlock) transpose_bits_32(active_, mask_);
    }
  }

 private:
  REDRIVE_INLINE void store_head(int r, __m512 low, __m512 high) const {
    if (r >= output_.head_rows) return;
    _mm512_mask_storeu_ps(head_ + r * output_.head_stride, valid0_, low);
    _mm512_mask_storeu_ps(head_ + r * output_.head_stride + 16, valid1_, high);
  }

  alignas(64) std::uint32_t active_[kBlock];  ///< per neuron, bit = sample
  const PassOutput& output_;
  int n_blocks_;
  const float* c_;
  bool exists_ = false;
  Bf16 *rows_ = nullptr, *pairs_ = nullptr;
  std::uint32_t* mask_ = nullptr;
  float* d_bias_ = nullptr;
  float *head_ = nullptr, *to_ = nullptr;
  __mmask16 valid0_ = 0, valid1_ = 0;
};

}  // namespace
}  // namespace redrive::kernels::bf16
