// SPDX-License-Identifier: Apache-2.0
// Layers of MLPs with bf16 products (vdpbf16ps) and fp32 sums. SIMD lanes are samples: the
// activations of a strip of 32 samples are pairs of neighbouring neurons, [neurons / 2][32
// samples], and weights are broadcast. Operands of weight gradients are kept by rows as well,
// [strips][neurons][32 samples]. Only for files with ISA flags (simd/vector.h).
#pragma once

// Included first: its REDRIVE_INLINE is used by both.
#include "redrive/kernels/cpu/simd/vector.h"

#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/grid/cpu/bf16_network.h"

#define REDRIVE_LAMBDA __attribute__((always_inline))

namespace redrive::kernels::REDRIVE_ISA {
namespace {

using bf16::Bf16, bf16::first_lanes, bf16::to_bf16, bf16::to_bf16_pairs;
using Pair [[gnu::may_alias]] = std::uint32_t;

constexpr int kStrip = kGridBf16Strip, kBlock = kGridBf16Block;

/// Permutation of two sources `a` and `b`: units of kUnit dwords alternately from their lower or
/// upper halves.
template <int kUnit>
struct ConcatenatedFunctors {
  alignas(64) std::int32_t low[16], high[16];
  constexpr ConcatenatedFunctors() : low(), high() {
    for (int i = 0; i < 16; ++i) {
      low[i] = i / kUnit / 2 * kUnit + i % kUnit + (i / kUnit % 2) * 16;
      high[i] = low[i] + 8;
    }
  }
};
template <int kUnit>
constexpr ConcatenatedFunctors<kUnit> kInTurn;

/// Even and odd dwords, or 16-bit words, of two vectors.
struct EveryOther {
  alignas(64) std::int32_t even[16], odd[16];
  alignas(64) std::uint16_t even_words[32], odd_words[32];
  constexpr EveryOther() : even(), odd(), even_words(), odd_words() {
    for (int i = 0; i < 16; ++i) odd[i] = (even[i] = 2 * i) + 1;
    for (int i = 0; i < 32; ++i) {
      even_words[i] = static_cast<std::uint16_t>(2 * i);
      odd_words[i] = static_cast<std::uint16_t>(2 * i + 1);
    }
  }
};
constexpr EveryOther kEveryOther;

REDRIVE_INLINE __m512i joined(const std::int32_t* index, __m512i a, __m512i b) {
  return _mm512_permutex2var_epi32(a, _mm512_load_si512(index), b);
}

/// Sums of kRows rows of a product for the samples of a strip.
template <int kRows>
struct Sums {
  __m512 at[kRows][2];
};

/// Computes rows sum_k a[row][k] x[k] in blocks of kRows, which begin with start(row, sums) and end
/// with finish(row, sums). a: [rows / kRows][pairs][kRows] pairs, x: [pairs][32 samples].
template <int kRows, class Start, class Finish>
REDRIVE_INLINE void product(int rows, int pairs, const Bf16* a, const Pair* x, const Start& start,
                            const Finish& finish) {
  const Pair* left = reinterpret_cast<const Pair*>(a);
  for (int row = 0; row < rows; row += kRows) {
    Sums<kRows> sums;
    start(row, sums);
    for (int k = 0; k < pairs; ++k, left += kRows) {
      const auto x0 = (__m512bh)_mm512_load_si512(x + k * kStrip),
                 x1 = (__m512bh)_mm512_load_si512(x + k * kStrip + 16);
#pragma GCC unroll 8
      for (int r = 0; r < kRows; ++r) {
        const auto w = (__m512bh)_mm512_set1_epi32(static_cast<int>(left[r]));
        sums.at[r][0] = _mm512_dpbf16_ps(sums.at[r][0], w, x0);
        sums.at[r][1] = _mm512_dpbf16_ps(sums.at[r][1], w, x1);
      }
    }
    finish(row, sums);
  }
}

struct FromZero {
  template <int kRows>
  REDRIVE_LAMBDA void operator()(int, Sums<kRows>& sums) const {
#pragma GCC unroll 8
    for (int r = 0; r < kRows; ++r) sums.at[r][0] = sums.at[r][1] = _mm512_setzero_ps();
  }
};

/// Activations of a layer: pairs of one strip, and rows of all strips, [strips][numbers][32
/// samples], or null.
struct Layer {
  Pair* pairs = nullptr;
  Bf16* rows = nullptr;
  int numbers = 0;

  /// Returns the layer at the strip that begins with sample `first`.
  REDRIVE_LAMBDA Layer at(int first) const {
    return {pairs, rows ? rows + first * numbers : nullptr, numbers};
  }
  template <bool kRows>
  REDRIVE_LAMBDA void put(int row, const Sums<kBlock>& sums) const {
#pragma GCC unroll 4
    for (int r = 0; r < kBlock; r += 2)
#pragma GCC unroll 2
      for (int v = 0; v < 2; ++v)
        _mm512_store_si512(pairs + (row + r) / 2 * kStrip + v * 16,
                           to_bf16_pairs(sums.at[r][v], sums.at[r + 1][v]));
    if constexpr (kRows)
#pragma GCC unroll 8
      for (int r = 0; r < kBlock; ++r)
        _mm512_store_si512(rows + (row + r) * kStrip, to_bf16(sums.at[r][0], sums.at[r][1]));
  }
  /// ReLU adjoint: writes the sums, 0 where `gate` <= 0.
  REDRIVE_LAMBDA void put_gated(int row, const Sums<kBlock>& sums, const Layer& gate) const {
    const __m512i zero = _mm512_setzero_si512();
    const __m512i order = _mm512_load_si512(bf16::kInterleave.at);
#pragma GCC unroll 4
    for (int r = 0; r < kBlock; r += 2)
#pragma GCC unroll 2
      for (int v = 0; v < 2; ++v) {
        const int at = (row + r) / 2 * kStrip + v * 16;
        const __mmask32 open = _mm512_cmpgt_epi16_mask(_mm512_load_si512(gate.pairs + at), zero);
        _mm512_store_si512(pairs + at, _mm512_maskz_permutexvar_epi16(
                                           open, order, to_bf16(sums.at[r][v], sums.at[r + 1][v])));
      }
#pragma GCC unroll 8
    for (int r = 0; r < kBlock; ++r) {
      const __mmask32 open =
          _mm512_cmpgt_epi16_mask(_mm512_load_si512(gate.rows + (row + r) * kStrip), zero);
      _mm512_store_si512(rows + (row + r) * kStrip,
                         _mm512_maskz_mov_epi16(open, to_bf16(sums.at[r][0], sums.at[r][1])));
    }
  }
};

template <int kRows>
REDRIVE_INLINE void rectify(Sums<kRows>& sums) {
#pragma GCC unroll 8
  for (int r = 0; r < kRows; ++r)  // NaN stays NaN: the second operand is taken
    for (int v = 0; v < 2; ++v) sums.at[r][v] = _mm512_max_ps(_mm512_setzero_ps(), sums.at[r][v]);
}

/// Loads or stores the first `numbers` elements of a vector, none if negative.
REDRIVE_INLINE __m512 load_masked(const float* from, int numbers) {
  return _mm512_maskz_loadu_ps(first_lanes(numbers), from);
}
REDRIVE_INLINE void store_masked(float* to, int numbers, __m512 x) {
  _mm512_mask_storeu_ps(to, first_lanes(numbers), x);
}

/// Loads the features of up to 32 samples, `count` of them valid; kFeatures features of a level are
/// adjacent.
template <int kFeatures, bool kKeep>
REDRIVE_INLINE void load_features(const GridNetworkTile& tile, int first, int count,
                                  const Layer& to) {
  constexpr int kPairs = kFeatures / 2;
  for (int l = 0; l < tile.n_levels; ++l) {
    const float* const from =
        tile.features + l * tile.level_stride + static_cast<std::size_t>(first) * kFeatures;
    __m512i pair[kPairs][2];
#pragma GCC unroll 2
    for (int v = 0; v < 2; ++v) {
      const int numbers = (count - v * 16) * kFeatures;
      __m512i of_samples[kPairs];
#pragma GCC unroll 4
      for (int j = 0; j < kPairs; ++j) {
        const float* const here = from + v * 16 * kFeatures + j * 32;
        of_samples[j] = to_bf16(load_masked(here, numbers - 32 * j),
                                load_masked(here + 16, numbers - 32 * j - 16));
      }
      const std::int32_t *const even = kEveryOther.even, *const odd = kEveryOther.odd;
      if constexpr (kPairs == 1) pair[0][v] = of_samples[0];
      if constexpr (kPairs == 2) {
        pair[0][v] = joined(even, of_samples[0], of_samples[1]);
        pair[1][v] = joined(odd, of_samples[0], of_samples[1]);
      }
      if constexpr (kPairs == 4) {
        const __m512i even0 = joined(even, of_samples[0], of_samples[1]),
                      even1 = joined(even, of_samples[2], of_samples[3]),
                      odd0 = joined(odd, of_samples[0], of_samples[1]),
                      odd1 = joined(odd, of_samples[2], of_samples[3]);
        pair[0][v] = joined(even, even0, even1);
        pair[1][v] = joined(even, odd0, odd1);
        pair[2][v] = joined(odd, even0, even1);
        pair[3][v] = joined(odd, odd0, odd1);
      }
    }
#pragma GCC unroll 4
    for (int j = 0; j < kPairs; ++j) {
      Pair* const pairs = to.pairs + (l * kPairs + j) * kStrip;
      _mm512_store_si512(pairs, pair[j][0]);
      _mm512_store_si512(pairs + 16, pair[j][1]);
      if constexpr (kKeep) {
        Bf16* const rows = to.rows + (l * kFeatures + 2 * j) * kStrip;
        const __m512i even = _mm512_load_si512(kEveryOther.even_words),
                      odd = _mm512_load_si512(kEveryOther.odd_words);
        _mm512_store_si512(rows, _mm512_permutex2var_epi16(pair[j][0], even, pair[j][1]));
        _mm512_store_si512(rows + kStrip, _mm512_permutex2var_epi16(pair[j][0], odd, pair[j][1]));
      }
    }
  }
}

/// The inverse: stores a block of rows sample by sample; its first row belongs to a level.
template <int kFeatures>
REDRIVE_INLINE void store_features(const Sums<kBlock>& sums, float* to, std::size_t level_stride,
                                   int count) {
#pragma GCC unroll 4
  for (int l = 0; l < kBlock / kFeatures; ++l)
#pragma GCC unroll 2
    for (int v = 0; v < 2; ++v) {
      __m512i x[kFeatures], y[kFeatures];
#pragma GCC unroll 8
      for (int r = 0; r < kFeatures; ++r) x[r] = _mm512_castps_si512(sums.at[l * kFeatures + r][v]);
      const auto join = [&](const auto& index, int unit) REDRIVE_LAMBDA {
#pragma GCC unroll 8
        for (int g = 0; g < kFeatures; g += 2 * unit)
#pragma GCC unroll 4
          for (int q = 0; q < unit; ++q) {
            y[g + 2 * q] = joined(index.low, x[g + q], x[g + unit + q]);
            y[g + 2 * q + 1] = joined(index.high, x[g + q], x[g + unit + q]);
          }
#pragma GCC unroll 8
        for (int r = 0; r < kFeatures; ++r) x[r] = y[r];
      };
      join(kInTurn<1>, 1);
      if constexpr (kFeatures >= 4) join(kInTurn<2>, 2);
      if constexpr (kFeatures >= 8) join(kInTurn<4>, 4);
      const int numbers = (count - v * 16) * kFeatures;
      float* const here = to + l * level_stride + v * 16 * kFeatures;
#pragma GCC unroll 8
      for (int r = 0; r < kFeatures; ++r)
        store_masked(here + 16 * r, numbers - 16 * r, _mm512_castsi512_ps(x[r]));
    }
}

/// Returns the 4 x 4 sums over lanes: lane i is the sum of sums[i / 4][i % 4].
REDRIVE_INLINE __m512 sums_of(const __m512 (&sums)[4][4]) {
  __m512 of_row[4];
#pragma GCC unroll 4
  for (int i = 0; i < 4; ++i) {
    const __m512* const s = sums[i];
    const __m512 a = _mm512_add_ps(_mm512_unpacklo_ps(s[0], s[1]), _mm512_unpackhi_ps(s[0], s[1])),
                 b = _mm512_add_ps(_mm512_unpacklo_ps(s[2], s[3]), _mm512_unpackhi_ps(s[2], s[3]));
    of_row[i] = _mm512_add_ps(_mm512_shuffle_ps(a, b, 0x44), _mm512_shuffle_ps(a, b, 0xee));
  }
  const auto halves = [](__m512 a, __m512 b) REDRIVE_LAMBDA {
    return _mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x88), _mm512_shuffle_f32x4(a, b, 0xdd));
  };
  return halves(halves(of_row[0], of_row[1]), halves(of_row[2], of_row[3]));
}

/// gradient[o][i] += sum over samples of d[o] x[i], over the first `outputs` and `inputs` rows;
/// `outputs` need not be a multiple of 4.
static __attribute__((noinline)) void add_gradient(int outputs, const Layer& d, int inputs,
                                                   const Layer& x, int samples, float* gradient) {
  const int d_numbers = d.numbers, x_numbers = x.numbers;
  for (int o = 0; o < outputs; o += 4)
    for (int i = 0; i < inputs; i += 4) {
      __m512 sums[4][4];
#pragma GCC unroll 4
      for (int m = 0; m < 4; ++m)
#pragma GCC unroll 4
        for (int n = 0; n < 4; ++n) sums[m][n] = _mm512_setzero_ps();
      const Bf16 *left = d.rows + o * kStrip, *right = x.rows + i * kStrip;
      for (int s = 0; s < samples;
           s += kStrip, left += d_numbers * kStrip, right += x_numbers * kStrip) {
        __m512bh of_x[4];
#pragma GCC unroll 4
        for (int n = 0; n < 4; ++n) of_x[n] = (__m512bh)_mm512_load_si512(right + n * kStrip);
#pragma GCC unroll 4
        for (int m = 0; m < 4; ++m) {
          const auto of_d = (__m512bh)_mm512_load_si512(left + m * kStrip);
#pragma GCC unroll 4
          for (int n = 0; n < 4; ++n) sums[m][n] = _mm512_dpbf16_ps(sums[m][n], of_d, of_x[n]);
        }
      }
      alignas(64) float added[16];
      _mm512_store_ps(added, sums_of(sums));
      float* const to = gradient + o * inputs + i;
      for (int m = 0; m < 4 && o + m < outputs; ++m)
        _mm_storeu_ps(to + m * inputs,
                      _mm_add_ps(_mm_loadu_ps(to + m * inputs), _mm_load_ps(added + 4 * m)));
    }
}

}  // namespace
}  // namespace redrive::kernels::REDRIVE_ISA
