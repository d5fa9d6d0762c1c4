// SPDX-License-Identifier: Apache-2.0
// Small AVX-512 helpers of the bf16 kernels: conversion, interleaving, transposes.
#pragma once

#include <immintrin.h>

#include "redrive/kernels/cpu/simd/bf16_layout.h"

#ifndef REDRIVE_INLINE
#define REDRIVE_INLINE inline __attribute__((always_inline))
#endif

namespace redrive::kernels::bf16 {
namespace {  // unnamed on purpose, so that nothing here is linked into code that runs anywhere

struct InterleaveIndex {
  alignas(64) std::uint16_t at[32];
  constexpr InterleaveIndex() : at() {
    for (int i = 0; i < 16; ++i) {
      at[2 * i] = static_cast<std::uint16_t>(i);
      at[2 * i + 1] = static_cast<std::uint16_t>(16 + i);
    }
  }
};
constexpr InterleaveIndex kInterleave;

/// 32 bf16, rounded to nearest even: first, then second.
REDRIVE_INLINE __m512i to_bf16(__m512 first, __m512 second) {
  return (__m512i)_mm512_cvtne2ps_pbh(second, first);
}

/// 16 pairs: (first[0], second[0]), (first[1], second[1]), ...
REDRIVE_INLINE __m512i to_bf16_pairs(__m512 first, __m512 second) {
  return _mm512_permutexvar_epi16(_mm512_load_si512(kInterleave.at), to_bf16(first, second));
}

REDRIVE_INLINE void store(Bf16* p, __m512i v) { _mm512_store_si512(p, v); }

/// Indices for transposing 32 x 32 bits held as 32 dwords. Bytes are gathered into 8 x 8 bit
/// matrices (four row groups x four byte columns, rows reversed because gf2p8affineqb counts them
/// from the top), GFNI transposes each, and the bytes are stored as rows of the result.
struct BitTransposeIndex {
  alignas(64) std::uint8_t gather[64];
  alignas(64) std::uint8_t scatter[128];
  constexpr BitTransposeIndex() : gather(), scatter() {
    for (int q = 0; q < 8; ++q) {
      for (int j = 0; j < 8; ++j)
        gather[q * 8 + j] = static_cast<std::uint8_t>((q / 4 * 8 + 7 - j) * 4 + q % 4);
    }
    for (int n = 0; n < 32; ++n) {
      for (int group = 0; group < 4; ++group) {
        scatter[n * 4 + group] =
            static_cast<std::uint8_t>((group < 2 ? 0 : 64) + (group & 1) * 32 + n);
      }
    }
  }
};
constexpr BitTransposeIndex kBitTranspose;

/// out[j] bit i = in[i] bit j; both 32 dwords, 64-byte aligned.
REDRIVE_INLINE void transpose_bits_32(const std::uint32_t* in, std::uint32_t* out) {
  const __m512i gather = _mm512_load_si512(kBitTranspose.gather);
  const __m512i identity = _mm512_set1_epi64(0x8040201008040201ll);
  __m512i low = _mm512_permutexvar_epi8(gather, _mm512_load_si512(in));
  __m512i high = _mm512_permutexvar_epi8(gather, _mm512_load_si512(in + 16));
  low = _mm512_gf2p8affine_epi64_epi8(identity, low, 0);
  high = _mm512_gf2p8affine_epi64_epi8(identity, high, 0);
  const __m512i scatter0 = _mm512_load_si512(kBitTranspose.scatter);
  const __m512i scatter1 = _mm512_load_si512(kBitTranspose.scatter + 64);
  _mm512_store_si512(out, _mm512_permutex2var_epi8(low, scatter0, high));
  _mm512_store_si512(out + 16, _mm512_permutex2var_epi8(low, scatter1, high));
}

/// v[i][j] <-> v[j][i], 16 x 16 floats: pairs of rows, then of pairs, then 128-bit lanes.
REDRIVE_INLINE void transpose_16x16(__m512 v[16]) {
  __m512 a[16];
#pragma GCC unroll 8
  for (int i = 0; i < 8; ++i) {
    a[2 * i] = _mm512_unpacklo_ps(v[2 * i], v[2 * i + 1]);
    a[2 * i + 1] = _mm512_unpackhi_ps(v[2 * i], v[2 * i + 1]);
  }
#pragma GCC unroll 4
  for (int i = 0; i < 4; ++i) {
    v[4 * i] = _mm512_shuffle_ps(a[4 * i], a[4 * i + 2], 0x44);
    v[4 * i + 1] = _mm512_shuffle_ps(a[4 * i], a[4 * i + 2], 0xee);
    v[4 * i + 2] = _mm512_shuffle_ps(a[4 * i + 1], a[4 * i + 3], 0x44);
    v[4 * i + 3] = _mm512_shuffle_ps(a[4 * i + 1], a[4 * i + 3], 0xee);
  }
  // v[4 i + j] now holds, in 128-bit lane l, rows 4 i .. 4 i + 3 of column 4 l + j.
#pragma GCC unroll 4
  for (int j = 0; j < 4; ++j) {
    const __m512 even0 = _mm512_shuffle_f32x4(v[j], v[4 + j], 0x88),
                 odd0 = _mm512_shuffle_f32x4(v[j], v[4 + j], 0xdd);
    const __m512 even1 = _mm512_shuffle_f32x4(v[8 + j], v[12 + j], 0x88);
    const __m512 odd1 = _mm512_shuffle_f32x4(v[8 + j], v[12 + j], 0xdd);
    a[j] = _mm512_shuffle_f32x4(even0, even1, 0x88);
    a[4 + j] = _mm512_shuffle_f32x4(odd0, odd1, 0x88);
    a[8 + j] = _mm512_shuffle_f32x4(even0, even1, 0xdd);
    a[12 + j] = _mm512_shuffle_f32x4(odd0, odd1, 0xdd);
  }
#pragma GCC unroll 16
  for (int i = 0; i < 16; ++i) v[i] = a[i];
}

/// The lowest n bits, n clamped to [0, 16].
REDRIVE_INLINE __mmask16 first_lanes(int n) {
  return n >= 16 ? __mmask16(0xffff) : n <= 0 ? __mmask16(0) : __mmask16((1u << n) - 1);
}

}  // namespace
}  // namespace redrive::kernels::bf16
