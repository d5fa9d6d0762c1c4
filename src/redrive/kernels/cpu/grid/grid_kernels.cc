// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace.
#include "redrive/kernels/cpu/grid/grid_kernels.h"

#include "redrive/kernels/cpu/grid/hash_kernels.h"
#include "redrive/kernels/cpu/grid/small_product.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

constexpr int kGeometry = 16, kHarmonics = 16, kColours = 16;  // the last: three of them used
constexpr float kMaxLogDensity = 15;

REDRIVE_INLINE Vf magnitude(Vf a) { return a < Vf{} ? -a : a; }
REDRIVE_INLINE void clear(float* p, std::size_t n) { std::memset(p, 0, n * sizeof(float)); }

/// x^(1/3), x >= 0, relative error below 1e-5: a third of the exponent, then Newton's steps. A footprint needs no more.
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
      const Vf begin = load_first(edges + i, count), end = load_first(edges + i + 1, count), t = half * (begin + end);
      Vf u[3], m{};
      for (int k = 0; k < 3; ++k) {
        u[k] = splat(origin[k]) + t * splat(direction[k]);
        m = maximum(m, magnitude(u[k]));
      }
      const Vf side = splat(angle) * t, volume = side * side * (end - begin);
      Vf factor, scale, shift;
      if (rays.unbounded) {
        const Vf beyond = maximum(m, one), shrink = (splat(2.0f) - one / beyond) / beyond;
        scale = shrink * splat(0.25f);
        shift = half;
        factor = cube_root(volume * shrink * shrink / (beyond * beyond)) * splat(0.25f / rays.half_m);
      } else {
        scale = shift = half;
        factor = cube_root(volume) * splat(0.5f / rays.half_m);
      }
      for (int k = 0; k < 3; ++k) store_first(rays.position + k * rays.stride + first + i, u[k] * scale + shift, count);
      store_first(rays.footprint + first + i, factor, count);
    }
  }
}

/// 1 - exp(-density dt) and exp(-density dt) of an interval; alpha or transparency may be null.
REDRIVE_INLINE void absorb(const float* edges, const float* density, int n, float* alpha, float* transparency) {
  for (int i = 0; i < n; i += kLanes) {
    const int count = n - i;
    const Vf length = load_first(edges + i + 1, count) - load_first(edges + i, count);
    const Exponential e = exponential(-load_first(density + i, count) * length);
    if (alpha) store_first(alpha + i, -e.minus_one, count);
    store_first(transparency + i, e.value, count);
  }
}

void weights(int n_rays, int per_ray, const float* edges, const float* density, float* weights, float* transparency) {
  for (int ray = 0; ray < n_rays; ++ray, edges += per_ray + 1, density += per_ray, weights += per_ray) {
    absorb(edges, density, per_ray, weights, transparency);
    float transmittance = 1;
    for (int i = 0; i < per_ray; ++i) {
      weights[i] *= transmittance;
      transmittance *= transparency[i];
    }
  }
}

void weights_backward(int n_rays, int per_ray, const float* edges, const float* density, const float* weights,
                      const float* d_weights, float* d_density, float* after) {
  for (int ray = 0; ray < n_rays; ++ray, edges += per_ray + 1, density += per_ray, weights += per_ray,
           d_weights += per_ray, d_density += per_ray) {
    absorb(edges, density, per_ray, nullptr, after);
    for (int i = 1; i < per_ray; ++i) after[i] *= after[i - 1];
    float behind = 0;
    for (int i = per_ray - 1; i >= 0; --i) {
      d_density[i] = (edges[i + 1] - edges[i]) * (after[i] * d_weights[i] - behind);
      behind += weights[i] * d_weights[i];
    }
  }
}

/// n: 2, 4 or 8, the features of a level.
REDRIVE_INLINE void copy_row(const float* from, float* to, int n) {
  if (n == 4)
    std::memcpy(to, from, 4 * sizeof(float));
  else if (n == 8)
    std::memcpy(to, from, 8 * sizeof(float));
  else
    std::memcpy(to, from, 2 * sizeof(float));
}

/// NaN stays NaN.
REDRIVE_INLINE void rectify(float* x, std::size_t n) {
  for (std::size_t i = 0; i < n; i += kLanes) store(x + i, load(x + i) < Vf{} ? Vf{} : load(x + i));
}
/// d where the rectified x is open, else 0.
REDRIVE_INLINE void rectify_backward(const float* x, float* d, std::size_t n) {
  for (std::size_t i = 0; i < n; i += kLanes) store(d + i, load(x + i) > Vf{} ? load(d + i) : Vf{});
}

/// Rows [samples, columns] one after the other.
REDRIVE_INLINE ProductInput rows_of(const float* data, int columns) {
  return {data, static_cast<std::size_t>(columns), 1};
}
/// The same, transposed.
REDRIVE_INLINE ProductInput columns_of(const float* data, int columns) {
  return {data, 1, static_cast<std::size_t>(columns)};
}

struct Activations {
  float *features, *d_features, *hidden, *geometry, *colour[2], *out, *density;
  float *d_wide, *d_wider, *d_geometry, *d_out;
  float *of_ray, *d_of_ray;
};

REDRIVE_INLINE Activations activations_in(float* scratch, std::size_t samples, std::size_t rays, int width,
                                          int inputs) {
  Activations a;
  float* next = scratch + (64 - reinterpret_cast<std::uintptr_t>(scratch) % 64) % 64 / sizeof(float);
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
  a.geometry = take(samples * kGeometry);
  a.d_geometry = take(samples * kGeometry);
  a.out = take(samples * kColours);
  a.d_out = take(samples * kColours);
  a.density = take(samples);
  a.of_ray = take(rays * width);
  a.d_of_ray = take(rays * width);
  return a;
}

void run_forward(const GridNetworkWeights& w, const GridNetworkTile& tile, const Activations& a) {
  const int width = w.width, samples = tile.n_rays * tile.per_ray;
  const std::size_t wide = static_cast<std::size_t>(samples) * width;
  for (int l = 0; l < tile.levels; ++l)
    for (int i = 0; i < samples; ++i)
      copy_row(tile.features + l * tile.level_stride + static_cast<std::size_t>(i) * tile.of_level,
               a.features + static_cast<std::size_t>(i) * w.inputs + l * tile.of_level, tile.of_level);
  clear(a.hidden, wide);
  add_product(samples, width, w.inputs, rows_of(a.features, w.inputs), w.density0_in, width, a.hidden, width);
  rectify(a.hidden, wide);
  clear(a.geometry, static_cast<std::size_t>(samples) * kGeometry);
  add_product(samples, kGeometry, width, rows_of(a.hidden, width), w.density1_in, kGeometry, a.geometry, kGeometry);
  for (int i = 0; i < samples; i += kLanes) {
    alignas(64) float log_density[kLanes]{};
    for (int j = 0; j < kLanes && i + j < samples; ++j)
      log_density[j] = a.geometry[static_cast<std::size_t>(i + j) * kGeometry];
    store(a.density + i, splat(w.density_scale) * exponential(minimum(splat(kMaxLogDensity), load(log_density))).value);
  }
  // What the direction adds is the same for all samples of a ray.
  clear(a.of_ray, static_cast<std::size_t>(tile.n_rays) * width);
  add_product(tile.n_rays, width, kHarmonics, rows_of(tile.harmonics, kHarmonics), w.harmonics_in, width, a.of_ray,
              width);
  for (int ray = 0; ray < tile.n_rays; ++ray)
    for (int s = 0; s < tile.per_ray; ++s)
      std::memcpy(a.colour[0] + (static_cast<std::size_t>(ray) * tile.per_ray + s) * width,
                  a.of_ray + static_cast<std::size_t>(ray) * width, width * sizeof(float));
  add_product(samples, width, kGeometry, rows_of(a.geometry, kGeometry), w.geometry_in, width, a.colour[0], width);
  rectify(a.colour[0], wide);
  if (w.colour_layers == 2) {
    clear(a.colour[1], wide);
    add_product(samples, width, width, rows_of(a.colour[0], width), w.colour1_in, width, a.colour[1], width);
    rectify(a.colour[1], wide);
  }
  clear(a.out, static_cast<std::size_t>(samples) * kColours);
  add_product(samples, kColours, width, rows_of(a.colour[w.colour_layers - 1], width), w.colour_out_in, kColours, a.out,
              kColours);
}

void network_forward(const GridNetworkWeights& w, const GridNetworkTile& tile, float* raw, float* scratch) {
  const int samples = tile.n_rays * tile.per_ray;
  const Activations a = activations_in(scratch, samples, tile.n_rays, w.width, w.inputs);
  run_forward(w, tile, a);
  for (int i = 0; i < samples; ++i)
    for (int k = 0; k < 3; ++k) raw[k * tile.raw_stride + i] = a.out[static_cast<std::size_t>(i) * kColours + k];
  std::memcpy(raw + 3 * tile.raw_stride, a.density, samples * sizeof(float));
}

void network_backward(const GridNetworkWeights& w, const GridNetworkTile& tile, const float* d_raw,
                      const GridNetworkGradients& gradients, float* d_features, float* scratch) {
  const int width = w.width, samples = tile.n_rays * tile.per_ray, last = w.colour_layers - 1;
  const std::size_t wide = static_cast<std::size_t>(samples) * width;
  const Activations a = activations_in(scratch, samples, tile.n_rays, width, w.inputs);
  run_forward(w, tile, a);
  for (int i = 0; i < samples; ++i)
    for (int k = 0; k < 3; ++k) a.d_out[static_cast<std::size_t>(i) * kColours + k] = d_raw[k * tile.raw_stride + i];

  float* d_colour = a.d_wide;
  clear(d_colour, wide);
  add_product(samples, width, 3, rows_of(a.d_out, kColours), w.colour_out, width, d_colour, width);
  add_product(3, width, samples, columns_of(a.d_out, kColours), a.colour[last], width, gradients.colour_out, width);
  rectify_backward(a.colour[last], d_colour, wide);
  if (last == 1) {
    clear(a.d_wider, wide);
    add_product(samples, width, width, rows_of(d_colour, width), w.colour1, width, a.d_wider, width);
    add_product(width, width, samples, columns_of(d_colour, width), a.colour[0], width, gradients.colour1, width);
    d_colour = a.d_wider;
    rectify_backward(a.colour[0], d_colour, wide);
  }
  constexpr int kInputs = kGeometry + kHarmonics;
  clear(a.d_geometry, static_cast<std::size_t>(samples) * kGeometry);
  add_product(samples, kGeometry, width, rows_of(d_colour, width), w.colour0, kInputs, a.d_geometry, kGeometry);
  add_product(width, kGeometry, samples, columns_of(d_colour, width), a.geometry, kGeometry, gradients.colour0,
              kInputs);
  for (int ray = 0; ray < tile.n_rays; ++ray)
    for (int c = 0; c < width; c += kLanes) {
      Vf sum{};
      for (int s = 0; s < tile.per_ray; ++s)
        sum += load(d_colour + (static_cast<std::size_t>(ray) * tile.per_ray + s) * width + c);
      store(a.d_of_ray + static_cast<std::size_t>(ray) * width + c, sum);
    }
  add_product(width, kHarmonics, tile.n_rays, columns_of(a.d_of_ray, width), tile.harmonics, kHarmonics,
              gradients.colour0 + kGeometry, kInputs);
  for (int i = 0; i < samples; ++i)
    a.d_geometry[static_cast<std::size_t>(i) * kGeometry] += d_raw[3 * tile.raw_stride + i] * a.density[i];

  float* const d_hidden = a.d_wide;
  clear(d_hidden, wide);
  add_product(samples, width, kGeometry, rows_of(a.d_geometry, kGeometry), w.density1, width, d_hidden, width);
  add_product(kGeometry, width, samples, columns_of(a.d_geometry, kGeometry), a.hidden, width, gradients.density1,
              width);
  rectify_backward(a.hidden, d_hidden, wide);
  clear(a.d_features, static_cast<std::size_t>(samples) * w.inputs);
  add_product(samples, w.inputs, width, rows_of(d_hidden, width), w.density0, w.inputs, a.d_features, w.inputs);
  add_product(width, w.inputs, samples, columns_of(d_hidden, width), a.features, w.inputs, gradients.density0,
              w.inputs);
  for (int l = 0; l < tile.levels; ++l)
    for (int i = 0; i < samples; ++i)
      copy_row(a.d_features + static_cast<std::size_t>(i) * w.inputs + l * tile.of_level,
               d_features + l * tile.level_stride + static_cast<std::size_t>(i) * tile.of_level, tile.of_level);
}

}  // namespace

extern const GridKernels kGridKernels = {contract, encode,           encode_backward, density,
                                         weights,  weights_backward, network_forward, network_backward};

}  // namespace redrive::kernels::REDRIVE_ISA
