// SPDX-License-Identifier: Apache-2.0
// Volume rendering of one ray by quadrature (NeRF eq. 3; Max 1995) and its adjoint, on any scalar
// type:
//   sigma_i = max(0, raw density), c_i = sigmoid(raw rgb), alpha_i = 1 - exp(-sigma_i dt_i),
//   T_i = prod_{j<i} (1 - alpha_j), w_i = T_i alpha_i,
//   C = sum w_i c_i + T_n background, depth = sum w_i t_i, opacity = sum w_i.
// Without a background it is black. Lengths in metres, densities in 1/m. dt_i may be +infinity (the
// last interval, as in the paper's code): alpha is then 1 where sigma > 0, else 0, and the
// derivative by sigma_i is 0. NaN stays NaN.
#pragma once

#include <cmath>
#include <cstddef>

#include "redrive/field/activation.h"

namespace redrive {

/// Result of one ray. Samples are in structure-of-arrays form: channel k of sample i is raw[k *
/// stride + i], k = r, g, b, density.
template <class T>
struct RayComposite {
  T rgb[3]{}, depth{}, opacity{};
};

/// Opacity alpha and transparency 1 - alpha of an interval, each to its own relative precision: 1 -
/// alpha would cancel for dense intervals, 1 - transparency for thin ones.
template <class T>
struct Absorption {
  T alpha, transparency;
};

template <class T>
Absorption<T> absorption(T raw_density, float dt) {
  using std::exp;
  using std::expm1;
  const T sigma = relu(raw_density);
  if (std::isinf(dt)) {
    if (sigma <= T(0)) return {T(0), T(1)};
    return {T(1) + T(0) * sigma, T(0)};  // 1 with derivative 0; NaN stays NaN
  }
  const T depth = sigma * T(dt);
  return {-expm1(-depth), exp(-depth)};
}

/// Composites n samples at distances t [n] with lengths dt [n]. weights [n] or null: written.
/// background [3] or null.
template <class T>
RayComposite<T> composite_ray(const T* raw, std::size_t stride, const float* t, const float* dt,
                              int n, T* weights, const T* background = nullptr) {
  RayComposite<T> out;
  T transmittance(1);
  for (int i = 0; i < n; ++i) {
    const Absorption<T> interval = absorption(raw[3 * stride + i], dt[i]);
    const T w = transmittance * interval.alpha;
    for (int k = 0; k < 3; ++k) out.rgb[k] += w * sigmoid(raw[k * stride + i]);
    out.depth += w * T(t[i]);
    out.opacity += w;
    if (weights) weights[i] = w;
    transmittance = transmittance * interval.transparency;
  }
  for (int k = 0; background && k < 3; ++k) out.rgb[k] += transmittance * background[k];
  return out;
}

/// Writes d_raw, laid out as raw, given d_rgb [3] and, unless null, d_weights [n]. With g_i = c_i .
/// d_rgb + d_w_i and the suffix sums R_i = sum_{j>i} w_j g_j + T_n background . d_rgb, in one
/// backward pass:
///   d sigma_i = dt_i (T_{i+1} g_i - R_i),   d raw_rgb = w_i c_i (1 - c_i) d_rgb.
/// The derivative by the background is T_n d_rgb.
template <class T>
void composite_ray_adjoint(const T* raw, std::size_t stride, const float* dt, int n,
                           const T d_rgb[3], T* d_raw, const T* d_weights = nullptr,
                           const T* background = nullptr) {
  // Recomputes T_i; d_raw's density channel holds it until it is overwritten.
  T transmittance(1);
  for (int i = 0; i < n; ++i) {
    d_raw[3 * stride + i] = transmittance;
    transmittance = transmittance * absorption(raw[3 * stride + i], dt[i]).transparency;
  }
  T behind(0);
  for (int k = 0; background && k < 3; ++k) behind += transmittance * background[k] * d_rgb[k];
  for (int i = n - 1; i >= 0; --i) {
    const Absorption<T> interval = absorption(raw[3 * stride + i], dt[i]);
    const T w = d_raw[3 * stride + i] * interval.alpha,
            after = d_raw[3 * stride + i] * interval.transparency;
    T colour = d_weights ? d_weights[i] : T(0);
    for (int k = 0; k < 3; ++k) {
      const T c = sigmoid(raw[k * stride + i]);
      colour += c * d_rgb[k];
      d_raw[k * stride + i] = w * c * (T(1) - c) * d_rgb[k];
    }
    const T d_sigma = after * colour - behind;
    behind += w * colour;
    const bool flat = raw[3 * stride + i] <= T(0) || std::isinf(dt[i]);
    d_raw[3 * stride + i] = flat ? T(0) : d_sigma * T(dt[i]);
  }
}

}  // namespace redrive
