// SPDX-License-Identifier: Apache-2.0
// MLPs of --method grid with bf16 products (vdpbf16ps) and fp32 sums. SIMD lanes are samples: a
// layer is stored as pairs of neighbouring neurons, [neurons / 2][32 samples], weights are
// broadcast, and a strip of 32 samples passes through all layers, forward and backward, before the
// next. Operands of weight gradients are kept by rows, [strips][neurons][32 samples], and
// multiplied at the end of the tile.
#include "redrive/kernels/cpu/grid/bf16_network.h"

#include "redrive/field/constants.h"

// Included first: its REDRIVE_INLINE is used by both.
#include "redrive/kernels/cpu/simd/vector.h"

#include "redrive/kernels/cpu/bf16/vector.h"

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

/// Activations of one tile. Rows are allocated for the backward pass only.
struct Activations {
  int samples;                                  ///< whole strips
  Layer features, hidden, geometry, colour[2];  ///< rows of the harmonics follow those of geometry
  Layer d_out, d_wide, d_wider, d_geometry, d_hidden;
  float *of_ray, *density;  ///< [width][16 rays], [32 samples]
  std::int32_t* ray_of;     ///< [samples]
};

REDRIVE_INLINE Activations activations_in(float* scratch, const GridBf16Weights& w, int samples,
                                          bool keep) {
  char* next =
      reinterpret_cast<char*>(scratch) + (64 - reinterpret_cast<std::uintptr_t>(scratch) % 64) % 64;
  const auto take = [&](std::size_t bytes) {
    char* const here = next;
    next += bytes;
    return here;
  };
  Activations a{};
  a.samples = grid_bf16_samples(samples);
  const auto layer = [&](int numbers) {
    Layer made{reinterpret_cast<Pair*>(take(numbers / 2 * kStrip * sizeof(Pair))), nullptr,
               numbers};
    if (keep)
      made.rows = reinterpret_cast<Bf16*>(
          take(static_cast<std::size_t>(numbers) * a.samples * sizeof(Bf16)));
    return made;
  };
  a.features = layer(w.inputs);
  a.hidden = layer(w.width);
  a.geometry = layer(kGeometryFeatures + kHarmonics);
  a.colour[0] = layer(w.width);
  a.colour[1] = layer(w.width);
  if (keep) {
    a.d_out = layer(4);
    a.d_wide = layer(w.width);
    a.d_wider = layer(w.width);
    a.d_geometry = layer(kGeometryFeatures);
    a.d_hidden = layer(w.width);
  }
  a.of_ray = reinterpret_cast<float*>(take(w.width * 16 * sizeof(float)));
  a.density = reinterpret_cast<float*>(take(kStrip * sizeof(float)));
  a.ray_of = reinterpret_cast<std::int32_t*>(take(a.samples * sizeof(std::int32_t)));
  return a;
}

/// Per ray, one SIMD lane each: transposes the harmonics and computes their part of the first
/// colour layer, which all samples of a ray share.
template <bool kKeep>
REDRIVE_INLINE void encode_ray_directions(const GridBf16Weights& w, const GridNetworkTile& tile,
                                          const Activations& a) {
  std::int32_t* ray_of = a.ray_of;
  for (int ray = 0; ray < tile.n_rays; ++ray)
    for (int s = 0; s < tile.per_ray; ++s) *ray_of++ = ray;
  while (ray_of < a.ray_of + a.samples) *ray_of++ = 0;

  __m512 harmonics[kHarmonics];
#pragma GCC unroll 16
  for (int ray = 0; ray < 16; ++ray)
    harmonics[ray] = ray < tile.n_rays ? _mm512_loadu_ps(tile.harmonics + ray * kHarmonics)
                                       : _mm512_setzero_ps();
  bf16::transpose_16x16(harmonics);
  __m512bh pairs[kHarmonics / 2];
#pragma GCC unroll 8
  for (int k = 0; k < kHarmonics / 2; ++k)
    pairs[k] = (__m512bh)to_bf16_pairs(harmonics[2 * k], harmonics[2 * k + 1]);
  const Pair* left = reinterpret_cast<const Pair*>(w.harmonics);
  for (int row = 0; row < w.width; row += kBlock, left += kBlock * kHarmonics / 2)
    for (int r = 0; r < kBlock; ++r) {
      __m512 sum = _mm512_setzero_ps();
#pragma GCC unroll 8
      for (int k = 0; k < kHarmonics / 2; ++k)
        sum = _mm512_dpbf16_ps(
            sum, (__m512bh)_mm512_set1_epi32(static_cast<int>(left[k * kBlock + r])), pairs[k]);
      _mm512_store_ps(a.of_ray + (row + r) * 16, sum);
    }
  if constexpr (kKeep)
    for (int s = 0; s < a.samples; s += kStrip) {
      const __m512i ray0 = _mm512_load_si512(a.ray_of + s),
                    ray1 = _mm512_load_si512(a.ray_of + s + 16);
#pragma GCC unroll 16
      for (int k = 0; k < kHarmonics; ++k)
        _mm512_store_si512(a.geometry.at(s).rows + (kGeometryFeatures + k) * kStrip,
                           to_bf16(_mm512_permutexvar_ps(ray0, harmonics[k]),
                                   _mm512_permutexvar_ps(ray1, harmonics[k])));
    }
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

/// The inverse: stores a block of rows, its first one that of a level, by samples.
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

/// Computes the layers up to the last hidden one for samples [first, first + count) of the tile.
template <int kFeatures, bool kKeep>
REDRIVE_INLINE void strip_forward(const GridBf16Weights& w, const GridNetworkTile& tile,
                                  const Activations& a, int first, int count) {
  const Layer features = a.features.at(first), hidden = a.hidden.at(first),
              geometry = a.geometry.at(first);
  load_features<kFeatures, kKeep>(tile, first, count, features);
  const auto rectified = [](const Layer& to) REDRIVE_LAMBDA {
    return [to](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA {
      rectify(sums);
      to.put<kKeep>(row, sums);
    };
  };
  product<kBlock>(w.width, w.inputs / 2, w.density0, features.pairs, FromZero(), rectified(hidden));
  product<kBlock>(kGeometryFeatures, w.width / 2, w.density1, hidden.pairs, FromZero(),
                  [&](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA {
                    geometry.put<kKeep>(row, sums);
                    if (row == 0)
                      for (int v = 0; v < 2; ++v) {
                        const Vf log_density =
                            minimum(splat(kMaxLogDensity), reinterpret_cast<Vf>(sums.at[0][v]));
                        store(a.density + 16 * v,
                              splat(w.density_scale) * exponential(log_density).value);
                      }
                  });
  const __m512i ray0 = _mm512_load_si512(a.ray_of + first),
                ray1 = _mm512_load_si512(a.ray_of + first + 16);
  const Layer colour = a.colour[0].at(first);
  product<kBlock>(
      w.width, kGeometryFeatures / 2, w.geometry, geometry.pairs,
      [&](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA {
#pragma GCC unroll 8
        for (int r = 0; r < kBlock; ++r) {
          const __m512 of_ray = _mm512_load_ps(a.of_ray + (row + r) * 16);
          sums.at[r][0] = _mm512_permutexvar_ps(ray0, of_ray);
          sums.at[r][1] = _mm512_permutexvar_ps(ray1, of_ray);
        }
      },
      rectified(colour));
  if (w.colour_layers == 2)
    product<kBlock>(w.width, w.width / 2, w.colour1, colour.pairs, FromZero(),
                    rectified(a.colour[1].at(first)));
}

/// Calls visit(first sample, samples) for each strip of a tile.
template <class Visit>
REDRIVE_INLINE void for_each_strip(int samples, const Visit& visit) {
  for (int first = 0; first < samples; first += kStrip)
    visit(first, samples - first < kStrip ? samples - first : kStrip);
}

template <int kFeatures>
void forward(const GridBf16Weights& w, const GridNetworkTile& tile, float* raw, float* scratch) {
  const int samples = tile.n_rays * tile.per_ray;
  const Activations a = activations_in(scratch, w, samples, false);
  encode_ray_directions<false>(w, tile, a);
  for_each_strip(samples, [&](int first, int count) REDRIVE_LAMBDA {
    strip_forward<kFeatures, false>(w, tile, a, first, count);
    product<4>(4, w.width / 2, w.colour_out, a.colour[w.colour_layers - 1].pairs, FromZero(),
               [&](int, Sums<4>& sums) REDRIVE_LAMBDA {
                 for (int v = 0; v < 2; ++v) {
                   sums.at[3][v] = _mm512_load_ps(a.density + 16 * v);
#pragma GCC unroll 4
                   for (int k = 0; k < 4; ++k)
                     store_masked(raw + k * tile.raw_stride + first + 16 * v, count - 16 * v,
                                  sums.at[k][v]);
                 }
               });
  });
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

template <int kFeatures>
void backward(const GridBf16Weights& w, const GridNetworkTile& tile, const float* d_raw,
              const GridNetworkGradients& gradients, float* d_features, float* scratch) {
  const int samples = tile.n_rays * tile.per_ray, last = w.colour_layers - 1, width = w.width;
  const Activations a = activations_in(scratch, w, samples, true);
  encode_ray_directions<true>(w, tile, a);
  const Layer& d_last = last == 1 ? a.d_wider : a.d_wide;
  for_each_strip(samples, [&](int first, int count) REDRIVE_LAMBDA {
    strip_forward<kFeatures, true>(w, tile, a, first, count);
    __m512 d[4][2];
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k)
#pragma GCC unroll 2
      for (int v = 0; v < 2; ++v)
        d[k][v] = load_masked(d_raw + k * tile.raw_stride + first + 16 * v, count - 16 * v);
    const Layer d_out = a.d_out.at(first);
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k)
      _mm512_store_si512(d_out.rows + k * kStrip,
                         k < 3 ? to_bf16(d[k][0], d[k][1]) : _mm512_setzero_si512());
#pragma GCC unroll 2
    for (int v = 0; v < 2; ++v) {
      _mm512_store_si512(d_out.pairs + 16 * v, to_bf16_pairs(d[0][v], d[1][v]));
      _mm512_store_si512(d_out.pairs + kStrip + 16 * v,
                         to_bf16_pairs(d[2][v], _mm512_setzero_ps()));
    }
    const auto gated = [first](const Layer& to, const Layer& gate) REDRIVE_LAMBDA {
      return [to = to.at(first), gate = gate.at(first)](int row, Sums<kBlock>& sums)
                 REDRIVE_LAMBDA { to.put_gated(row, sums, gate); };
    };
    product<kBlock>(width, 2, w.colour_out_back, d_out.pairs, FromZero(),
                    gated(d_last, a.colour[last]));
    if (last == 1)
      product<kBlock>(width, width / 2, w.colour1_back, d_last.pairs, FromZero(),
                      gated(a.d_wide, a.colour[0]));
    const Layer d_geometry = a.d_geometry.at(first);
    product<kBlock>(
        kGeometryFeatures, width / 2, w.geometry_back, a.d_wide.pairs,
        [&](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA {
          FromZero()(row, sums);
          if (row == 0)
            for (int v = 0; v < 2; ++v)
              sums.at[0][v] = _mm512_mul_ps(d[3][v], _mm512_load_ps(a.density + 16 * v));
        },
        [&](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA { d_geometry.put<true>(row, sums); });
    product<kBlock>(width, kGeometryFeatures / 2, w.density1_back, d_geometry.pairs, FromZero(),
                    gated(a.d_hidden, a.hidden));
    product<kBlock>(w.inputs, width / 2, w.density0_back, a.d_hidden.pairs, FromZero(),
                    [&](int row, Sums<kBlock>& sums) REDRIVE_LAMBDA {
                      store_features<kFeatures>(sums,
                                                d_features + row / kFeatures * tile.level_stride +
                                                    static_cast<std::size_t>(first) * kFeatures,
                                                tile.level_stride, count);
                    });
  });
  const int n = a.samples;
  add_gradient(3, a.d_out, width, a.colour[last], n, gradients.colour_out);
  if (last == 1) add_gradient(width, a.d_wider, width, a.colour[0], n, gradients.colour1);
  add_gradient(width, a.d_wide, kGeometryFeatures + kHarmonics, a.geometry, n, gradients.colour0);
  add_gradient(kGeometryFeatures, a.d_geometry, width, a.hidden, n, gradients.density1);
  add_gradient(width, a.d_hidden, w.inputs, a.features, n, gradients.density0);
}

void network_forward(const GridBf16Weights& w, const GridNetworkTile& tile, float* raw,
                     float* scratch) {
  switch (tile.features_per_level) {
    case 2: return forward<2>(w, tile, raw, scratch);
    case 4: return forward<4>(w, tile, raw, scratch);
    default: return forward<8>(w, tile, raw, scratch);
  }
}

void network_backward(const GridBf16Weights& w, const GridNetworkTile& tile, const float* d_raw,
                      const GridNetworkGradients& gradients, float* d_features, float* scratch) {
  switch (tile.features_per_level) {
    case 2: return backward<2>(w, tile, d_raw, gradients, d_features, scratch);
    case 4: return backward<4>(w, tile, d_raw, gradients, d_features, scratch);
    default: return backward<8>(w, tile, d_raw, gradients, d_features, scratch);
  }
}

}  // namespace

extern const GridBf16Kernels kGridBf16Kernels = {network_forward, network_backward};

}  // namespace redrive::kernels::REDRIVE_ISA
