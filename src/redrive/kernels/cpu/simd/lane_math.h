// SPDX-License-Identifier: Apache-2.0
// Vector operations for Gaussians and scores: masks as each instruction set blends by them, powers
// and logarithms of two, sums of many vectors at once, and the arithmetic (math/lanes.h).
// Only for files with ISA flags (simd/vector.h).
#pragma once

#include "redrive/kernels/cpu/simd/vector.h"
#include "redrive/math/angle_of.h"

namespace redrive::kernels::REDRIVE_ISA {

#ifdef __AVX512F__
using LaneMask = __mmask16;
REDRIVE_INLINE LaneMask greater(Vf a, Vf b) {
  return _mm512_cmp_ps_mask(reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b), _CMP_GT_OQ);
}
REDRIVE_INLINE Vf kept(LaneMask mask, Vf a) {
  return reinterpret_cast<Vf>(_mm512_maskz_mov_ps(mask, reinterpret_cast<__m512>(a)));
}
REDRIVE_INLINE bool any(LaneMask mask) { return mask != 0; }
#else
using LaneMask = Vi;
REDRIVE_INLINE LaneMask greater(Vf a, Vf b) { return a > b; }
REDRIVE_INLINE Vf kept(LaneMask mask, Vf a) {
  return reinterpret_cast<Vf>(mask & reinterpret_cast<Vi>(a));
}
REDRIVE_INLINE bool any(LaneMask mask) { return lane_bits(mask) != 0; }
#endif

REDRIVE_INLINE Vf magnitude_of(Vf x) {
  return reinterpret_cast<Vf>(reinterpret_cast<Vi>(x) & splat_int(0x7fffffff));
}

/// 2^x with a relative error below 3e-6 for x in [-126, 126]: 2^n 2^f, |f| <= 1/2, 2^f by its
/// series to f^5 (the next term is 2.4e-6 at 1/2).
REDRIVE_INLINE Vf power_of_two(Vf x) {
  const Vf n = round_small(x), f = x - n;
  Vf p = splat(1.33335581e-3f);
  p = p * f + splat(9.61812910e-3f);
  p = p * f + splat(5.55041087e-2f);
  p = p * f + splat(2.40226507e-1f);
  p = p * f + splat(6.93147181e-1f);
  p = p * f + splat(1.0f);
#ifdef __AVX512F__
  return reinterpret_cast<Vf>(
      _mm512_scalef_ps(reinterpret_cast<__m512>(p), reinterpret_cast<__m512>(n)));
#else
  return reinterpret_cast<Vf>(reinterpret_cast<Vi>(p) + (__builtin_convertvector(n, Vi) << 23));
#endif
}

/// log2 of normal positive numbers with an absolute error below 1e-6: exponent and mantissa m in
/// [sqrt(1/2), sqrt(2)), log m = 2 artanh((m - 1) / (m + 1)) by its series to the ninth power.
REDRIVE_INLINE Vf logarithm_of_two(Vf x) {
  const Vi bits = reinterpret_cast<Vi>(x), shifted = bits - splat_int(0x3f3504f3),
           exponent = shifted >> 23;
  const Vf m = reinterpret_cast<Vf>((shifted & splat_int(0x7fffff)) + splat_int(0x3f3504f3));
  const Vf z = (m - splat(1.0f)) / (m + splat(1.0f)), z2 = z * z;
  Vf p = splat(1.0f / 9);
  p = p * z2 + splat(1.0f / 7);
  p = p * z2 + splat(1.0f / 5);
  p = p * z2 + splat(1.0f / 3);
  p = p * z2 + splat(1.0f);
  return __builtin_convertvector(exponent, Vf) + p * z * splat(2.88539008f);
}

/// The lane of a pair of vectors whose sum with the lane kGroup further is lane i of add_halves.
template <int kGroup>
REDRIVE_INLINE constexpr int first_half(int i) {
  const int within = i % (kLanes / 2), from = i < kLanes / 2 ? 0 : kLanes;
  return from + within / kGroup * 2 * kGroup + within % kGroup;
}

/// Lanes of two vectors after adding the halves of their groups of 2 * kGroup lanes: a's lanes,
/// then b's.
template <int kGroup>
REDRIVE_INLINE Vf add_halves(Vf a, Vf b) {
  return shuffle(a, b, [](int i) { return first_half<kGroup>(i); }) +
         shuffle(a, b, [](int i) { return first_half<kGroup>(i) + kGroup; });
}

/// Lane i of the result is the sum of the lanes of v[i], i < kLanes; kCount of them are not zero.
template <int kCount>
REDRIVE_INLINE Vf sums_of(const Vf* v) {
  static_assert(kCount <= kLanes && kCount > 1);
  const auto at = [&](int i) { return i < kCount ? v[i] : Vf{}; };
#ifdef __AVX512F__
  Vf four[4];
  for (int i = 0; i < 4; ++i)
    four[i] = 4 * i < kCount ? add_halves<4>(add_halves<8>(at(4 * i), at(4 * i + 1)),
                                             add_halves<8>(at(4 * i + 2), at(4 * i + 3)))
                             : Vf{};
  return add_halves<1>(add_halves<2>(four[0], four[1]), add_halves<2>(four[2], four[3]));
#else
  Vf two[2];
  for (int i = 0; i < 2; ++i)
    two[i] = 4 * i < kCount ? add_halves<2>(add_halves<4>(at(4 * i), at(4 * i + 1)),
                                            add_halves<4>(at(4 * i + 2), at(4 * i + 3)))
                            : Vf{};
  return add_halves<1>(two[0], two[1]);
#endif
}

/// The arithmetic of one vector.
struct LaneMath {
  using Real = Vf;
  using Mask = Vi;
  static constexpr int kLanes = REDRIVE_ISA::kLanes;

  REDRIVE_INLINE Vf constant(float x) { return splat(x); }
  REDRIVE_INLINE Vf sqrt(Vf x) { return square_root(x); }
  REDRIVE_INLINE Vf atan2(Vf y, Vf x) { return angle_of<LaneMath>(y, x); }
  REDRIVE_INLINE Vf exp(Vf x) { return exponential(x).value; }
  REDRIVE_INLINE Vf log(Vf x) { return logarithm_of_two(x) * splat(0.693147181f); }
  REDRIVE_INLINE Vf min(Vf a, Vf b) { return minimum(a, b); }
  REDRIVE_INLINE Vf max(Vf a, Vf b) { return maximum(a, b); }
  REDRIVE_INLINE Vf select(Vi holds, Vf a, Vf b) { return holds ? a : b; }
  REDRIVE_INLINE Vi both(Vi a, Vi b) { return a & b; }
  REDRIVE_INLINE Vi either(Vi a, Vi b) { return a | b; }
  REDRIVE_INLINE Vf stopped(Vf x) { return x; }
};

}  // namespace redrive::kernels::REDRIVE_ISA
