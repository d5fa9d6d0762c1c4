// SPDX-License-Identifier: Apache-2.0
// Computes gamma(x) and gamma(d) (field/positional_encoding.h) of a tile in the layouts of the
// first products' operands.
//
// sin(2^l pi p), cos(2^l pi p) by doubling the angle, sin 2a = 2 sin a cos a, cos 2a = 1 - 2 sin^2
// a, from l = 0 and again from l = 5: four doublings multiply the initial error of 1e-7 by at most
// 2^4 (measured 4e-6; bf16 near 1 rounds by 2e-3). 32 p is exact.
#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {
namespace {

constexpr int kReseedOctave = 5;

/// sin(pi p), cos(pi p) for any finite p: p = q / 2 + r, q whole, |r| <= 1/4 exactly; Taylor series
/// of sin and cos in a = pi r, |a| <= pi / 4, to a^9 and a^8 (remainders 2e-9 and 3e-8), then the
/// quadrant q mod 4.
REDRIVE_INLINE void sin_cos_pi(__m512 p, __m512& sine, __m512& cosine) {
  const __m512 q =
      _mm512_roundscale_ps(_mm512_add_ps(p, p), _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  const __m512 r = _mm512_fnmadd_ps(q, _mm512_set1_ps(0.5f), p);
  const __m512 a = _mm512_mul_ps(r, _mm512_set1_ps(3.14159265358979f));
  const __m512 a2 = _mm512_mul_ps(a, a);
  __m512 s = _mm512_set1_ps(1.0f / 362880);
  s = _mm512_fmadd_ps(s, a2, _mm512_set1_ps(-1.0f / 5040));
  s = _mm512_fmadd_ps(s, a2, _mm512_set1_ps(1.0f / 120));
  s = _mm512_fmadd_ps(s, a2, _mm512_set1_ps(-1.0f / 6));
  s = _mm512_fmadd_ps(_mm512_mul_ps(s, a2), a, a);
  __m512 c = _mm512_set1_ps(1.0f / 40320);
  c = _mm512_fmadd_ps(c, a2, _mm512_set1_ps(-1.0f / 720));
  c = _mm512_fmadd_ps(c, a2, _mm512_set1_ps(1.0f / 24));
  c = _mm512_fmadd_ps(c, a2, _mm512_set1_ps(-0.5f));
  c = _mm512_fmadd_ps(c, a2, _mm512_set1_ps(1.0f));
  const __m512i quadrant = _mm512_cvtps_epi32(
      q);  // |q| >= 2^31 gives 0x80000000: quadrant 0, as for every float so large
  const __mmask16 swap = _mm512_test_epi32_mask(quadrant, _mm512_set1_epi32(1));
  const __m512i two = _mm512_set1_epi32(2);
  const __m512i sine_sign = _mm512_slli_epi32(_mm512_and_si512(quadrant, two), 30);
  const __m512i cosine_sign = _mm512_slli_epi32(
      _mm512_and_si512(_mm512_add_epi32(quadrant, _mm512_set1_epi32(1)), two), 30);
  sine = (__m512)_mm512_xor_si512((__m512i)_mm512_mask_blend_ps(swap, s, c), sine_sign);
  cosine = (__m512)_mm512_xor_si512((__m512i)_mm512_mask_blend_ps(swap, c, s), cosine_sign);
}

/// gamma of 16 points given as three coordinates: out[row * stride], row = index in gamma.
REDRIVE_INLINE void encode_16(const __m512 point[3], int octaves, float* out, int stride) {
  for (int d = 0; d < 3; ++d) {
    _mm512_store_ps(out + d * stride, point[d]);
    float* row = out + (3 + 2 * d * octaves) * stride;
    __m512 s, c;
    sin_cos_pi(point[d], s, c);
    for (int l = 0; l < octaves; ++l, row += 2 * stride) {
      if (l == kReseedOctave)
        sin_cos_pi(_mm512_mul_ps(point[d], _mm512_set1_ps(1 << kReseedOctave)), s, c);
      _mm512_store_ps(row, s);
      _mm512_store_ps(row + stride, c);
      const __m512 twice = _mm512_add_ps(s, s), s2 = _mm512_mul_ps(twice, c);
      c = _mm512_fnmadd_ps(twice, s, _mm512_set1_ps(1.0f));
      s = s2;
    }
  }
}

/// gamma(x) of every sample; n = samples rounded up to blocks of 32, points past the tile's are the
/// origin.
void encode_positions(const Plan& plan, const ChunkMemory& memory, const float* position,
                      int samples, bool keep) {
  constexpr int kMaxRows = 64;  // 3 + 6 * 10, rounded up to blocks
  alignas(64) float code[kMaxRows * kBlock];
  const int blocks = plan.position_blocks, rows = 3 + 6 * plan.position_octaves,
            n = (samples + kBlock - 1) / kBlock;
  for (int i = rows * kBlock; i < blocks * kBlock * kBlock; ++i) code[i] = 0.0f;
  for (int b = 0; b < n; ++b) {
    for (int half = 0; half < 2; ++half) {
      const int first = b * kBlock + 16 * half;
      const __mmask16 valid = first_lanes(samples - first);
      __m512 point[3];
      for (int d = 0; d < 3; ++d)
        point[d] = _mm512_maskz_loadu_ps(valid, position + std::ptrdiff_t(d) * samples + first);
      encode_16(point, plan.position_octaves, code + 16 * half, kBlock);
    }
    for (int row = 0; row < blocks * kBlock; row += 2) {
      const int block = row / kBlock, r = row % kBlock;
      const __m512 even0 = _mm512_load_ps(code + row * kBlock),
                   even1 = _mm512_load_ps(code + row * kBlock + 16);
      const __m512 odd0 = _mm512_load_ps(code + (row + 1) * kBlock),
                   odd1 = _mm512_load_ps(code + (row + 1) * kBlock + 16);
      Bf16* next =
          memory.position_next + std::ptrdiff_t(b * blocks + block) * kBlockSize + r / 2 * kBlock;
      store(next, to_bf16_pairs(even0, odd0));
      store(next + kTileSize, to_bf16_pairs(even1, odd1));
      if (!keep) continue;
      Bf16* kept = memory.position_keep + std::ptrdiff_t(block * n + b) * kBlockSize + r * kBlock;
      store(kept, to_bf16(even0, even1));
      store(kept + kBlock, to_bf16(odd0, odd1));
    }
  }
}

/// gamma(d), computed once per ray, then copied to its samples: memory.ray_code holds a row of 32
/// bf16 per ray.
void encode_directions(const Plan& plan, const ChunkMemory& memory, const TileInput& tile,
                       bool keep) {
  alignas(64) float code[kBlock * 16];
  const int rows = 3 + 6 * plan.direction_octaves, samples = tile.n_rays * tile.per_ray;
  for (int i = 0; i < kBlock * 16; ++i) code[i] = 0.0f;
  for (int first = 0; first < tile.n_rays; first += 16) {
    const __mmask16 valid = first_lanes(tile.n_rays - first);
    __m512 direction[3];
    for (int d = 0; d < 3; ++d) {
      direction[d] =
          _mm512_maskz_loadu_ps(valid, tile.direction + std::ptrdiff_t(d) * tile.n_rays + first);
    }
    encode_16(direction, plan.direction_octaves, code, 16);
    for (int row = 0; row < rows; ++row) {
      alignas(64) Bf16 rounded[kBlock];
      store(rounded, to_bf16(_mm512_load_ps(code + row * 16), _mm512_setzero_ps()));
      for (int i = 0; i < 16 && first + i < tile.n_rays; ++i)
        memory.ray_code[(first + i) * kBlock + row] = rounded[i];
    }
  }
  const int n = (samples + kBlock - 1) / kBlock;
  for (int b = 0; b < n; ++b) {
    Bf16* next = memory.direction_next + std::ptrdiff_t(b) * kBlockSize;
    Bf16* kept = memory.direction_keep + std::ptrdiff_t(b) * kBlockSize;
    const __m512i zero = _mm512_setzero_si512();
    for (int i = 0; i < 32; ++i) store(next + i * kBlock, zero);
    for (int i = 0; keep && i < 32; ++i) store(kept + i * kBlock, zero);
    const int end = (b + 1) * kBlock < samples ? (b + 1) * kBlock : samples;
    for (int begin = b * kBlock; begin < end;) {  // the part of each ray that lies in this block
      const int ray = begin / tile.per_ray, ray_end = (ray + 1) * tile.per_ray,
                stop = ray_end < end ? ray_end : end;
      const std::uint64_t below_stop = (std::uint64_t{1} << (stop - b * kBlock)) - 1;
      const std::uint64_t below_begin = (std::uint64_t{1} << (begin - b * kBlock)) - 1;
      const auto part = static_cast<std::uint32_t>(below_stop & ~below_begin);
      const Bf16* ray_code = memory.ray_code + std::ptrdiff_t(ray) * kBlock;
      for (int pair = 0; pair < 16; ++pair) {
        const int both = ray_code[2 * pair] | ray_code[2 * pair + 1] << 16;
        Bf16* row = next + pair * kBlock;
        _mm512_mask_storeu_epi32(row, static_cast<__mmask16>(part), _mm512_set1_epi32(both));
        _mm512_mask_storeu_epi32(row + kTileSize, static_cast<__mmask16>(part >> 16),
                                 _mm512_set1_epi32(both));
      }
      for (int row = 0; keep && row < kBlock; ++row) {
        _mm512_mask_storeu_epi16(kept + row * kBlock, part,
                                 _mm512_set1_epi16(static_cast<short>(ray_code[row])));
      }
      begin = stop;
    }
  }
}

}  // namespace

void encode_tile(const Plan& plan, const ChunkMemory& memory, const TileInput& tile, bool keep) {
  encode_positions(plan, memory, tile.position, tile.n_rays * tile.per_ray, keep);
  encode_directions(plan, memory, tile, keep);
}

void encode_positions_backward(const Plan& plan, const ChunkMemory& memory, int samples,
                               float* d_position) {
  constexpr int kMaxRows = 64;
  alignas(64) float d_code[kMaxRows * 16];
  const int blocks = plan.position_blocks, octaves = plan.position_octaves,
            n = (samples + kBlock - 1) / kBlock;
  for (int first = 0; first < samples; first += 16) {
    const int b = first / kBlock, half = first / 16 % 2;
    for (int column = 0; column < 2 * blocks; ++column) {  // 16 rows of gamma
      const std::ptrdiff_t at = std::ptrdiff_t(b * blocks + column / 2) * kBlockSize +
                                (2 * half + column % 2) * kTileFloats;
      __m512 v[16];
      for (int r = 0; r < 16; ++r)
        v[r] = _mm512_add_ps(_mm512_load_ps(memory.d_gamma[0] + at + r * 16),
                             _mm512_load_ps(memory.d_gamma[1] + at + r * 16));
      transpose_16x16(v);
      for (int r = 0; r < 16; ++r) _mm512_store_ps(d_code + (column * 16 + r) * 16, v[r]);
    }
    const auto code = [&](int row) {
      const Bf16* kept = memory.position_keep + std::ptrdiff_t(row / kBlock * n + b) * kBlockSize +
                         row % kBlock * kBlock;
      const __m256i bits = _mm256_load_si256(reinterpret_cast<const __m256i*>(kept + 16 * half));
      return (__m512)_mm512_slli_epi32(_mm512_cvtepu16_epi32(bits), 16);
    };
    for (int d = 0; d < 3; ++d) {
      __m512 sum = _mm512_load_ps(d_code + d * 16);
      float frequency = 3.14159265358979f;
      for (int l = 0; l < octaves; ++l, frequency *= 2) {
        const int sine = 3 + 2 * (d * octaves + l), cosine = sine + 1;
        const __m512 turn =
            _mm512_fmsub_ps(code(cosine), _mm512_load_ps(d_code + sine * 16),
                            _mm512_mul_ps(code(sine), _mm512_load_ps(d_code + cosine * 16)));
        sum = _mm512_fmadd_ps(_mm512_set1_ps(frequency), turn, sum);
      }
      _mm512_mask_storeu_ps(d_position + std::ptrdiff_t(d) * samples + first,
                            first_lanes(samples - first), sum);
    }
  }
}

}  // namespace redrive::kernels::bf16
