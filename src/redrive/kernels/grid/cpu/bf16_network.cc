// SPDX-License-Identifier: Apache-2.0
// MLPs of --method grid with bf16 products (vdpbf16ps) and fp32 sums. A strip of 32 samples passes
// through all layers (bf16_layers.h), forward and backward, before the next. Operands of weight
// gradients are multiplied at the end of the tile.
#include "redrive/kernels/grid/cpu/bf16_network.h"

#include "redrive/field/constants.h"
#include "redrive/kernels/grid/cpu/bf16_layers.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

/// Activations of one tile. Rows are allocated for the backward pass only.
struct Activations {
  int samples;  ///< whole strips
  /// rows of the harmonics follow the rows of geometry
  Layer features, hidden, geometry, colour[2];
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
