// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace. -ffp-contract=off, so that
// Adam is bit-equal to the scalar function; -fno-math-errno for a vector square root.
#include "redrive/kernels/cpu/cpu_kernels.h"

#include "redrive/kernels/cpu/simd/vector.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

REDRIVE_INLINE bool is_infinite(float x) { return x == __builtin_inff(); }

REDRIVE_INLINE Vf sigmoid(Vf x) { return splat(1.0f) / (splat(1.0f) + exponential(-x).value); }

/// Writes alpha and 1 - alpha of every sample of a ray (volume/composite.h, absorption) in whole
/// vectors; sigma is 0 beyond n.
REDRIVE_INLINE void absorb(const float* density, const float* dt, int n, float* alpha,
                           float* transparency) {
  const Vf zero{}, one = splat(1.0f);
  for (int i = 0; i < n; i += kLanes) {
    const Vf raw = load_first(density + i, n - i), length = load_first(dt + i, n - i);
    const Vf sigma = raw <= zero ? zero : raw;
    const Vi infinite = length == splat(__builtin_inff());
    const Exponential e = exponential(-sigma * (infinite ? zero : length));
    const Vf step_alpha = sigma <= zero ? zero : one + zero * sigma,
             step_rest = sigma <= zero ? one : zero;
    store(alpha + i, infinite ? step_alpha : -e.minus_one);
    store(transparency + i, infinite ? step_rest : e.value);
  }
}

void composite_forward(const CompositeForward& rays, const CompositeResult& out, float* scratch) {
  const int n = rays.per_ray, padded = (n + kLanes - 1) / kLanes * kLanes;
  float *weight = scratch, *transparency = scratch + padded;
  for (int ray = 0; ray < rays.n_rays; ++ray) {
    const std::size_t first = static_cast<std::size_t>(ray) * n;
    const float* raw = rays.raw + first;
    absorb(raw + 3 * rays.raw_stride, rays.dt + first, n, weight, transparency);
    float transmittance = 1;
    for (int i = 0; i < n; ++i) {
      weight[i] *= transmittance;
      transmittance *= transparency[i];
    }
    Vf depth{}, opacity{}, rgb[3]{};
    for (int i = 0; i < n; i += kLanes) {
      const Vf w = load_first(weight + i, n - i);
      for (int k = 0; k < 3; ++k)
        rgb[k] += w * sigmoid(load_first(raw + k * rays.raw_stride + i, n - i));
      depth += w * load_first(rays.t + first + i, n - i);
      opacity += w;
    }
    for (int k = 0; k < 3; ++k) {
      const float behind = rays.background
                               ? transmittance * rays.background[k * rays.background_stride + ray]
                               : 0.0f;
      out.rgb[k * out.rgb_stride + ray] = sum(rgb[k]) + behind;
    }
    out.depth[ray] = sum(depth);
    out.opacity[ray] = sum(opacity);
    if (out.weights)
      for (int i = 0; i < n; i += kLanes)
        store_first(out.weights + first + i, load(weight + i), n - i);
  }
}

void composite_backward(const CompositeForward& rays, const CompositeGradient& adjoint,
                        float* scratch) {
  const int n = rays.per_ray, padded = (n + kLanes - 1) / kLanes * kLanes;
  float *weight = scratch, *after = scratch + padded, *colour = scratch + 2 * padded;
  for (int ray = 0; ray < rays.n_rays; ++ray) {
    const std::size_t first = static_cast<std::size_t>(ray) * n;
    const float* raw = rays.raw + first;
    float* d_raw = adjoint.d_raw + first;
    absorb(raw + 3 * rays.raw_stride, rays.dt + first, n, weight, after);
    float transmittance = 1;
    for (int i = 0; i < n; ++i) {
      weight[i] *= transmittance;
      transmittance *= after[i];
      after[i] = transmittance;
    }
    Vf d_rgb[3];
    for (int k = 0; k < 3; ++k) d_rgb[k] = splat(adjoint.d_rgb[k * adjoint.d_rgb_stride + ray]);
    for (int i = 0; i < n; i += kLanes) {
      // c . d_rgb: the three channels' suffix sums are one
      Vf dot = adjoint.d_weights ? load_first(adjoint.d_weights + first + i, n - i) : Vf{};
      const Vf w = load_first(weight + i, n - i);
      for (int k = 0; k < 3; ++k) {
        const Vf c = sigmoid(load_first(raw + k * rays.raw_stride + i, n - i));
        dot += c * d_rgb[k];
        store_first(d_raw + k * adjoint.d_raw_stride + i, w * c * (splat(1.0f) - c) * d_rgb[k],
                    n - i);
      }
      store(colour + i, dot);
    }
    float behind = 0;
    if (rays.background)
      for (int k = 0; k < 3; ++k)
        behind += transmittance * rays.background[k * rays.background_stride + ray] *
                  adjoint.d_rgb[k * adjoint.d_rgb_stride + ray];
    for (int i = n - 1; i >= 0; --i) {
      const float d_sigma = after[i] * colour[i] - behind;
      behind += weight[i] * colour[i];
      const float dt = rays.dt[first + i];
      const bool flat = raw[3 * rays.raw_stride + i] <= 0 || is_infinite(dt);
      d_raw[3 * adjoint.d_raw_stride + i] = flat ? 0.0f : d_sigma * dt;
    }
  }
}

void adam(const AdamRange& range) {
  const AdamRange r = range;
  const Vf zero{}, beta1 = splat(r.beta1), beta2 = splat(r.beta2), rest1 = splat(1 - r.beta1),
                   rest2 = splat(1 - r.beta2);
  for (std::size_t i = 0; i < r.n; i += kLanes) {
    const int count = r.n - i < kLanes ? static_cast<int>(r.n - i) : kLanes;
    const Vf gradient = load_first(r.gradients + i, count);
    const Vi no_gradient = gradient == zero;
    if (r.lazy && all_lanes(no_gradient)) continue;
    const Vf m0 = load_first(r.first_moment + i, count),
             v0 = load_first(r.second_moment + i, count), p0 = load_first(r.parameters + i, count);
    Vf m = beta1 * m0 + rest1 * gradient, v = beta2 * v0 + rest2 * gradient * gradient;
    Vf p = p0 - splat(r.learning_rate) * (m * splat(r.bias1)) /
                    (square_root(v * splat(r.bias2)) + splat(r.epsilon));
    if (r.lazy) {
      m = no_gradient ? m0 : m;
      v = no_gradient ? v0 : v;
      p = no_gradient ? p0 : p;
    }
    store_first(r.first_moment + i, m, count);
    store_first(r.second_moment + i, v, count);
    store_first(r.parameters + i, p, count);
    store_first(r.gradients + i, zero, count);
  }
}

}  // namespace

extern const CpuKernels kCpuKernels = {composite_forward, composite_backward, adam};

}  // namespace redrive::kernels::REDRIVE_ISA
