// SPDX-License-Identifier: Apache-2.0
// Vectors of floats in the width of the instruction set this file is compiled for (GCC vector
// extensions). Only for files with ISA flags: everything here has internal linkage in a namespace
// per ISA, and such files call no inline function of the standard library or of the project. The
// linker keeps one copy of an inline function, and it must not be the one that needs AVX-512.
#pragma once

#include <immintrin.h>

#include <cstdint>
#include <cstring>
#include <utility>

#define REDRIVE_INLINE static inline __attribute__((always_inline))

namespace redrive::kernels::REDRIVE_ISA {

#ifdef __AVX512F__
constexpr int kLanes = 16;
#else
constexpr int kLanes = 8;
#endif

typedef float Vf __attribute__((vector_size(kLanes * 4)));
typedef std::int32_t Vi __attribute__((vector_size(kLanes * 4)));
typedef std::uint32_t Vu __attribute__((vector_size(kLanes * 4)));
typedef float UnalignedVf __attribute__((vector_size(kLanes * 4), aligned(4), may_alias));

REDRIVE_INLINE Vf splat(float x) { return x - Vf{}; }
REDRIVE_INLINE Vi splat_int(std::int32_t x) { return x - Vi{}; }
REDRIVE_INLINE Vu splat_unsigned(std::uint32_t x) { return x - Vu{}; }
REDRIVE_INLINE Vf load(const float* p) { return *reinterpret_cast<const UnalignedVf*>(p); }
REDRIVE_INLINE void store(float* p, Vf v) { *reinterpret_cast<UnalignedVf*>(p) = v; }

/// Loads the first min(count, kLanes) numbers of p; the other lanes are 0.
REDRIVE_INLINE Vf load_first(const float* p, int count) {
  if (count >= kLanes) return load(p);
  Vf v{};
  std::memcpy(&v, p, static_cast<std::size_t>(count) * sizeof(float));
  return v;
}
REDRIVE_INLINE void store_first(float* p, Vf v, int count) {
  if (count >= kLanes) return store(p, v);
  std::memcpy(p, &v, static_cast<std::size_t>(count) * sizeof(float));
}

REDRIVE_INLINE float sum(Vf v) {
  float s = 0;
  for (int i = 0; i < kLanes; ++i) s += v[i];
  return s;
}

/// Lanes Lane()(0), Lane()(1), ... of the pair (a, b), where b's follow a's. Lane is a lambda
/// without captures.
template <class V, class Lane, int... i>
REDRIVE_INLINE V shuffle(V a, V b, Lane, std::integer_sequence<int, i...>) {
  return __builtin_shufflevector(a, b, Lane()(i)...);
}
template <class V, class Lane>
REDRIVE_INLINE V shuffle(V a, V b, Lane lane) {
  return shuffle(a, b, lane, std::make_integer_sequence<int, kLanes>());
}

/// Returns the result of a comparison as bits: bit i is lane i's.
REDRIVE_INLINE unsigned lane_bits(Vi holds) {
#ifdef __AVX512F__
  return _mm512_movepi32_mask(reinterpret_cast<__m512i>(holds));
#else
  return _mm256_movemask_ps(reinterpret_cast<__m256>(holds));
#endif
}
REDRIVE_INLINE bool all_lanes(Vi holds) { return lane_bits(holds) == (1u << kLanes) - 1; }

/// NaN in b stays NaN.
REDRIVE_INLINE Vf minimum(Vf a, Vf b) { return a < b ? a : b; }
REDRIVE_INLINE Vf maximum(Vf a, Vf b) { return a > b ? a : b; }

REDRIVE_INLINE Vf square_root(Vf x) {
#ifdef __AVX512F__
  return reinterpret_cast<Vf>(_mm512_sqrt_ps(reinterpret_cast<__m512>(x)));
#else
  return reinterpret_cast<Vf>(_mm256_sqrt_ps(reinterpret_cast<__m256>(x)));
#endif
}

/// Nearest integer, ties to even, |x| < 2^22: adding 1.5 * 2^23 leaves no bits for the fraction.
REDRIVE_INLINE Vf round_small(Vf x) {
  const Vf magic = splat(12582912.0f);
  return (x + magic) - magic;
}

/// e^x and e^x - 1, each with a relative error below 4e-7; x is clamped to [-87, 88] (no
/// subnormals, no infinity); NaN stays NaN. x = n ln 2 + r, |r| <= ln(2)/2, ln 2 in two parts (Cody
/// and Waite); e^r - 1 by its series to r^7 / 5040 (the next term is below 6e-9).
struct Exponential {
  Vf value, minus_one;
};
REDRIVE_INLINE Exponential exponential(Vf x) {
  x = x < splat(-87.0f) ? splat(-87.0f) : x;
  x = x > splat(88.0f) ? splat(88.0f) : x;
  const Vf n = round_small(x * splat(1.44269504088896341f));
  const Vf r = (x - n * splat(0.693145751953125f)) - n * splat(1.42860682030941723e-6f);
  Vf p = splat(1.0f / 5040);
  p = p * r + splat(1.0f / 720);
  p = p * r + splat(1.0f / 120);
  p = p * r + splat(1.0f / 24);
  p = p * r + splat(1.0f / 6);
  p = p * r + splat(0.5f);
  p = p * r * r + r;
  const Vf power = reinterpret_cast<Vf>((__builtin_convertvector(n, Vi) + splat_int(127)) << 23);
  return {p * power + power, p * power + (power - splat(1.0f))};
}

/// sin(pi x) and cos(pi x) for any finite x, absolute error below 2e-7. The reduction to a quarter
/// turn is exact, since it subtracts multiples of 1/2 from x itself, not of pi/2 from pi x.
REDRIVE_INLINE void sincos_pi(Vf x, Vf* sine, Vf* cosine) {
  // Whole turns first: beyond 2^23 every float is an integer, beyond 2^24 an even one.
  const Vf magnitude = x < Vf{} ? -x : x;
  x = magnitude >= splat(16777216.0f) ? Vf{} : x;
  const Vf turns = magnitude < splat(4194304.0f)
                       ? round_small(x * splat(0.5f))
                       : __builtin_convertvector(__builtin_convertvector(x * splat(0.5f), Vi), Vf);
  x -= turns + turns;
  const Vf quarter = round_small(x + x);
  const Vf a = (x - quarter * splat(0.5f)) * splat(3.14159265358979323846f);  // |a| <= pi/4
  const Vf a2 = a * a;
  // Taylor: the next terms at pi/4 are 3e-10 (sine, a^11/11!) ... 2e-9 (cosine, a^10/10! = 2.5e-8
  // is kept).
  Vf s = splat(1.0f / 362880);
  s = s * a2 - splat(1.0f / 5040);
  s = s * a2 + splat(1.0f / 120);
  s = s * a2 - splat(1.0f / 6);
  s = s * a2 * a + a;
  Vf c = splat(-1.0f / 3628800);
  c = c * a2 + splat(1.0f / 40320);
  c = c * a2 - splat(1.0f / 720);
  c = c * a2 + splat(1.0f / 24);
  c = c * a2 - splat(0.5f);
  c = c * a2 + splat(1.0f);
  // quarter mod 4: 0 (s, c), 1 (c, -s), 2 (-s, -c), 3 (-c, s).
  const Vi q = __builtin_convertvector(quarter, Vi);
  const Vi swap = (q & splat_int(1)) != splat_int(0);
  const Vf s0 = swap ? c : s, c0 = swap ? s : c;
  const Vi sine_sign = (q & splat_int(2)) << 30, cosine_sign = ((q + splat_int(1)) & splat_int(2))
                                                               << 30;
  *sine = reinterpret_cast<Vf>(reinterpret_cast<Vi>(s0) ^ sine_sign);
  *cosine = reinterpret_cast<Vf>(reinterpret_cast<Vi>(c0) ^ cosine_sign);
}

}  // namespace redrive::kernels::REDRIVE_ISA
