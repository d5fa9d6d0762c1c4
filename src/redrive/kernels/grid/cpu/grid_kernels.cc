// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace.
#include "redrive/kernels/grid/cpu/grid_kernels.h"

#include "redrive/field/constants.h"
#include "redrive/kernels/grid/cpu/hash_kernels.h"
#include "redrive/kernels/grid/cpu/small_product.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

constexpr int kColours = 16;  // columns of the colour output, three of them used

REDRIVE_INLINE Vf magnitude(Vf a) { return a < Vf{} ? -a : a; }

/// Cube root of x >= 0 with a relative error below 1e-5, enough for footprints: a third of the
/// exponent, then Newton steps.
REDRIVE_INLINE Vf cube_root(Vf x) {
  x = maximum(x, splat(1e-30f));
  Vf y = reinterpret_cast<Vf>(reinterpret_cast<Vi>(x) / splat_int(3) + splat_int(709921077));
  for (int i = 0; i < 3; ++i) y = y - (y * y * y - x) / (splat(3.0f) * y * y);
  return y;
}

void contract(const GridRays& rays) {
  const Vf one = splat(1.0f), half = splat(0.5f);
  for (int ray = 0; ray < rays.n_rays; ++ray) {
    const float* edges = rays.edges + static_cast<std::size_t>(ray) * (rays.per_ray + 1);
    const std::size_t first = static_cast<std::size_t>(ray) * rays.per_ray;
    const float angle = rays.pixel_angle[ray];
    float origin[3], direction[3];
    for (int k = 0; k < 3; ++k) {
      origin[k] = (rays.origin[k * rays.ray_stride + ray] - rays.center[k]) / rays.half_m;
      direction[k] = rays.direction[k * rays.ray_stride + ray] / rays.half_m;
    }
    for (int i = 0; i < rays.per_ray; i += kLanes) {
      const int count = rays.per_ray - i;
      const Vf begin = load_first(edges + i, count), end = load_first(edges + i + 1, count),
               t = half * (begin + end);
      Vf u[3], m{};
      for (int k = 0; k < 3; ++k) {
        u[k] = splat(origin[k]) + t * splat(direction[k]);
        m = maximum(m, magnitude(u[k]));
      }
      const Vf side = splat(angle) * t, length = end - begin,
               least = splat(rays.least_width) * length,
               volume = maximum(least * least * least, side * side * length);
      Vf factor, scale, shift;
      if (rays.unbounded) {
        const Vf beyond = maximum(m, one), shrink = (splat(2.0f) - one / beyond) / beyond;
        scale = shrink * splat(0.25f);
        shift = half;
        factor =
            cube_root(volume * shrink * shrink / (beyond * beyond)) * splat(0.25f / rays.half_m);
      } else {
        scale = shift = half;
        factor = cube_root(volume) * splat(0.5f / rays.half_m);
      }
      for (int k = 0; k < 3; ++k)
        store_first(rays.position + k * rays.stride + first + i, u[k] * scale + shift, count);
      store_first(rays.footprint + first + i, factor, count);
    }
  }
}

/// Writes 1 - exp(-density dt) (alpha, may be null) and exp(-density dt) of each interval.
REDRIVE_INLINE void absorb(const float* edges, const float* density, int n, float* alpha,
                           float* transparency) {
  for (int i = 0; i < n; i += kLanes) {
    const int count = n - i;
    const Vf length = load_first(edges + i + 1, count) - load_first(edges + i, count);
    const Exponential e = exponential(-load_first(density + i, count) * length);
    if (alpha) store_first(alpha + i, -e.minus_one, count);
    store_first(transparency + i, e.value, count);
  }
}

void weights(int n_rays, int per_ray, const float* edges, const float* density, float* weights,
             float* transparency) {
  for (int ray = 0; ray < n_rays;
       ++ray, edges += per_ray + 1, density += per_ray, weights += per_ray) {
    absorb(edges, density, per_ray, weights, transparency);
    float transmittance = 1;
    for (int i = 0; i < per_ray; ++i) {
      weights[i] *= transmittance;
      transmittance *= transparency[i];
    }
  }
}

void weights_backward(int n_rays, int per_ray, const float* edges, const float* density,
                      const float* weights, const float* d_weights, float* d_density,
                      float* after) {
  for (int ray = 0; ray < n_rays; ++ray, edges += per_ray + 1, density += per_ray,
           weights += per_ray, d_weights += per_ray, d_density += per_ray) {
    absorb(edges, density, per_ray, nullptr, after);
    for (int i = 1; i < per_ray; ++i) after[i] *= after[i - 1];
    float behind = 0;
    for (int i = per_ray - 1; i >= 0; --i) {
      d_density[i] = (edges[i + 1] - edges[i]) * (after[i] * d_weights[i] - behind);
      behind += weights[i] * d_weights[i];
    }
  }
}

/// Transposes the features of a tile from [levels, all samples, kFeatures] to [samples, inputs], or
/// back.
template <int kFeatures, bool kBack>
REDRIVE_INLINE void regroup(const GridNetworkTile& tile, const float* from, float* to) {
  const int samples = tile.n_rays * tile.per_ray, n_levels = tile.n_levels;
  const std::size_t inputs = static_cast<std::size_t>(n_levels) * kFeatures;
  for (int l = 0; l < n_levels; ++l) {
    const std::size_t by_level = l * tile.level_stride,
                      by_sample = static_cast<std::size_t>(l) * kFeatures;
    const float* source = from + (kBack ? by_sample : by_level);
    float* target = to + (kBack ? by_level : by_sample);
    for (int i = 0; i < samples; ++i) {
      if (!kBack) __builtin_prefetch(source + samples * kFeatures);  // the next tile
      std::memcpy(target, source, kFeatures * sizeof(float));
      source += kBack ? inputs : kFeatures;
      target += kBack ? kFeatures : inputs;
    }
  }
}
template <bool kBack>
void regroup(const GridNetworkTile& tile, const float* from, float* to) {
  switch (tile.features_per_level) {
    case 2: return regroup<2, kBack>(tile, from, to);
    case 4: return regroup<4, kBack>(tile, from, to);
    default: return regroup<8, kBack>(tile, from, to);
  }
}

/// Rows [samples, columns].
REDRIVE_INLINE ProductInput rows_of(const float* data, int columns) {
  return {data, static_cast<std::size_t>(columns), 1};
}
/// The transpose of rows [samples, columns].
REDRIVE_INLINE ProductInput columns_of(const float* data, int columns) {
  return {data, 1, static_cast<std::size_t>(columns)};
}

struct Activations {
  float *features, *d_features, *hidden, *geometry, *colour[2], *out, *density;
  float *d_wide, *d_wider, *d_geometry, *d_out;
  float *of_ray, *d_of_ray;
};

REDRIVE_INLINE Activations activations_in(float* scratch, std::size_t samples, std::size_t rays,
                                          int width, int inputs) {
  Activations a;
  float* next =
      scratch + (64 - reinterpret_cast<std::uintptr_t>(scratch) % 64) % 64 / sizeof(float);
  const auto take = [&](std::size_t size) {
    float* const here = next;
    next += (size + 15) / 16 * 16;
    return here;
  };
  a.features = take(samples * inputs);
  a.d_features = take(samples * inputs);
  a.hidden = take(samples * width);
  a.colour[0] = take(samples * width);
  a.colour[1] = take(samples * width);
  a.d_wide = take(samples * width);
  a.d_wider = take(samples * width);
  a.geometry = take(samples * kGeometryFeatures);
  a.d_geometry = take(samples * kGeometryFeatures);
  a.out = take(samples * kColours);
  a.d_out = take(samples * kColours);
  a.density = take(samples);
  a.of_ray = take(rays * width);
  a.d_of_ray = take(rays * width);
  return a;
}

/// Computes the layers up to the last hidden one.
void run_forward(const GridNetworkWeights& w, const GridNetworkTile& tile, const Activations& a) {
  const int width = w.width, samples = tile.n_rays * tile.per_ray;
  const std::size_t row = width;
  regroup<false>(tile, tile.features, a.features);
  product<Start::kZero, Finish::kRelu>(
      {samples, width, w.inputs, rows_of(a.features, w.inputs), w.density0_in, row, a.hidden, row});
  product<Start::kZero, Finish::kPlain>({samples, kGeometryFeatures, width,
                                         rows_of(a.hidden, width), w.density1_in, kGeometryFeatures,
                                         a.geometry, kGeometryFeatures});
  for (int i = 0; i < samples; i += kLanes) {
    alignas(64) float log_density[kLanes]{};
    for (int j = 0; j < kLanes && i + j < samples; ++j)
      log_density[j] = a.geometry[static_cast<std::size_t>(i + j) * kGeometryFeatures];
    store(a.density + i, splat(w.density_scale) *
                             exponential(minimum(splat(kMaxLogDensity), load(log_density))).value);
  }
  // All samples of a ray share the direction's part.
  product<Start::kZero, Finish::kPlain>({tile.n_rays, width, kHarmonics,
                                         rows_of(tile.harmonics, kHarmonics), w.harmonics_in, row,
                                         a.of_ray, row});
  for (int ray = 0; ray < tile.n_rays; ++ray) {
    const std::size_t first = static_cast<std::size_t>(ray) * tile.per_ray;
    product<Start::kRow, Finish::kRelu>(
        {.rows = tile.per_ray,
         .columns = width,
         .depth = kGeometryFeatures,
         .a = rows_of(a.geometry + first * kGeometryFeatures, kGeometryFeatures),
         .b = w.geometry_in,
         .b_row = row,
         .c = a.colour[0] + first * row,
         .c_row = row,
         .start = a.of_ray + ray * row});
  }
  if (w.colour_layers == 2)
    product<Start::kZero, Finish::kRelu>(
        {samples, width, width, rows_of(a.colour[0], width), w.colour1_in, row, a.colour[1], row});
}

void network_forward(const GridNetworkWeights& w, const GridNetworkTile& tile, float* raw,
                     float* scratch) {
  const int samples = tile.n_rays * tile.per_ray, width = w.width;
  const Activations a = activations_in(scratch, samples, tile.n_rays, w.width, w.inputs);
  run_forward(w, tile, a);
  product<Start::kZero, Finish::kPlain>({samples, kColours, width,
                                         rows_of(a.colour[w.colour_layers - 1], width),
                                         w.colour_out_in, kColours, a.out, kColours});
  for (int i = 0; i < samples; ++i)
    for (int k = 0; k < 3; ++k)
      raw[k * tile.raw_stride + i] = a.out[static_cast<std::size_t>(i) * kColours + k];
  std::memcpy(raw + 3 * tile.raw_stride, a.density, samples * sizeof(float));
}

void network_backward(const GridNetworkWeights& w, const GridNetworkTile& tile, const float* d_raw,
                      const GridNetworkGradients& gradients, float* d_features, float* scratch) {
  const int width = w.width, samples = tile.n_rays * tile.per_ray, last = w.colour_layers - 1;
  const std::size_t row = width, inputs = w.inputs;
  const Activations a = activations_in(scratch, samples, tile.n_rays, width, w.inputs);
  run_forward(w, tile, a);
  for (int i = 0; i < samples; ++i)
    for (int k = 0; k < 3; ++k)
      a.d_out[static_cast<std::size_t>(i) * kColours + k] = d_raw[k * tile.raw_stride + i];
  /// Adds the gradient of a layer [outputs, inputs], from d [samples, outputs] and x [samples,
  /// inputs].
  const auto add_gradient = [&](int outputs, int columns, const float* d, int d_row, const float* x,
                                float* gradient, std::size_t gradient_row)
      __attribute__((always_inline)) {
    product<Start::kSum, Finish::kPlain>({outputs, columns, samples, columns_of(d, d_row), x,
                                          static_cast<std::size_t>(columns), gradient,
                                          gradient_row});
  };

  float* d_colour = a.d_wide;
  product<Start::kZero, Finish::kReluAdjoint>({samples, width, 3, rows_of(a.d_out, kColours),
                                               w.colour_out, row, d_colour, row, nullptr,
                                               a.colour[last]});
  add_gradient(3, width, a.d_out, kColours, a.colour[last], gradients.colour_out, row);
  if (last == 1) {
    product<Start::kZero, Finish::kReluAdjoint>({samples, width, width, rows_of(d_colour, width),
                                                 w.colour1, row, a.d_wider, row, nullptr,
                                                 a.colour[0]});
    add_gradient(width, width, d_colour, width, a.colour[0], gradients.colour1, row);
    d_colour = a.d_wider;
  }
  constexpr int kInputs = kGeometryFeatures + kHarmonics;
  product<Start::kZero, Finish::kPlain>({samples, kGeometryFeatures, width,
                                         rows_of(d_colour, width), w.colour0, kInputs, a.d_geometry,
                                         kGeometryFeatures});
  add_gradient(width, kGeometryFeatures, d_colour, width, a.geometry, gradients.colour0, kInputs);
  for (int ray = 0; ray < tile.n_rays; ++ray)
    for (int c = 0; c < width; c += kLanes) {
      Vf sum{};
      for (int s = 0; s < tile.per_ray; ++s)
        sum += load(d_colour + (static_cast<std::size_t>(ray) * tile.per_ray + s) * width + c);
      store(a.d_of_ray + static_cast<std::size_t>(ray) * width + c, sum);
    }
  product<Start::kSum, Finish::kPlain>({width, kHarmonics, tile.n_rays,
                                        columns_of(a.d_of_ray, width), tile.harmonics, kHarmonics,
                                        gradients.colour0 + kGeometryFeatures, kInputs});
  for (int i = 0; i < samples; ++i)
    a.d_geometry[static_cast<std::size_t>(i) * kGeometryFeatures] +=
        d_raw[3 * tile.raw_stride + i] * a.density[i];

  float* const d_hidden = a.d_wide;
  product<Start::kZero, Finish::kReluAdjoint>({samples, width, kGeometryFeatures,
                                               rows_of(a.d_geometry, kGeometryFeatures), w.density1,
                                               row, d_hidden, row, nullptr, a.hidden});
  add_gradient(kGeometryFeatures, width, a.d_geometry, kGeometryFeatures, a.hidden,
               gradients.density1, row);
  product<Start::kZero, Finish::kPlain>({samples, w.inputs, width, rows_of(d_hidden, width),
                                         w.density0, inputs, a.d_features, inputs});
  add_gradient(width, w.inputs, d_hidden, width, a.features, gradients.density0, inputs);
  regroup<true>(tile, a.d_features, d_features);
}

}  // namespace

extern const GridKernels kGridKernels = {contract,        encode,          encode_backward,
                                         density,         weights,         weights_backward,
                                         network_forward, network_backward};

}  // namespace redrive::kernels::REDRIVE_ISA
