// SPDX-License-Identifier: Apache-2.0
// Volume rendering of one ray by quadrature (NeRF eq. 3; Max 1995) and its adjoint, scalar, on any scalar type.
//   sigma_i = max(0, raw density), c_i = sigmoid(raw rgb), alpha_i = 1 - exp(-sigma_i dt_i),
//   T_i = prod_{j<i} (1 - alpha_j), w_i = T_i alpha_i, C = sum w_i c_i, depth = sum w_i t_i, opacity = sum w_i.
// dt_i may be +infinity (the last interval, as in the paper's code): alpha is then 1 where sigma > 0, else 0, and the
// gradient of sigma_i is 0.
#pragma once

#include <cmath>

namespace redrive {

/// One ray in structure-of-arrays form: channel k of sample i is raw[k * stride + i], k = r, g, b, density.
template <class T>
struct RayComposite {
  T rgb[3]{}, depth{}, opacity{};
};

template <class T>
T composite_alpha(T sigma, float dt) {
  using std::exp;
  if (std::isinf(dt)) return sigma > T(0) ? T(1) : T(0);
  return T(1) - exp(-sigma * T(dt));
}

template <class T>
T sigmoid(T x) {
  using std::exp;
  return T(1) / (T(1) + exp(-x));
}

/// `weights` may be null; else [n].
template <class T>
RayComposite<T> composite_ray(const T* raw, std::size_t stride, const float* t, const float* dt, int n, T* weights) {
  RayComposite<T> out;
  T transmittance(1);
  for (int i = 0; i < n; ++i) {
    const T density = raw[3 * stride + i];
    const T alpha = composite_alpha(density > T(0) ? density : T(0), dt[i]);
    const T w = transmittance * alpha;
    for (int k = 0; k < 3; ++k) out.rgb[k] += w * sigmoid(raw[k * stride + i]);
    out.depth += w * T(t[i]);
    out.opacity += w;
    if (weights) weights[i] = w;
    transmittance = transmittance * (T(1) - alpha);
  }
  return out;
}

/// d_raw[k * stride + i] = d loss / d raw, given d loss / d rgb (3 values). The suffix sums
/// R_i = sum_{j>i} w_j c_j turn the adjoint into one backward pass:
///   d sigma_i = dt_i (T_{i+1} c_i - R_i) . d_rgb,   d raw_rgb = w_i c_i (1 - c_i) d_rgb.
template <class T>
void composite_ray_adjoint(const T* raw, std::size_t stride, const float* dt, int n, const T d_rgb[3], T* d_raw) {
  // Forward once more for T and w; kept in d_raw's density channel (T_{i+1}) until it is overwritten.
  T transmittance(1);
  for (int i = 0; i < n; ++i) {
    const T density = raw[3 * stride + i];
    transmittance = transmittance * (T(1) - composite_alpha(density > T(0) ? density : T(0), dt[i]));
    d_raw[3 * stride + i] = transmittance;
  }
  T behind[3]{};
  for (int i = n - 1; i >= 0; --i) {
    const T after = d_raw[3 * stride + i];
    const T before = i > 0 ? d_raw[3 * stride + i - 1] : T(1);
    const T w = before - after;
    T d_sigma(0);
    for (int k = 0; k < 3; ++k) {
      const T c = sigmoid(raw[k * stride + i]);
      d_sigma += (after * c - behind[k]) * d_rgb[k];
      d_raw[k * stride + i] = w * c * (T(1) - c) * d_rgb[k];
      behind[k] += w * c;
    }
    const bool active = raw[3 * stride + i] > T(0) && !std::isinf(dt[i]);
    d_raw[3 * stride + i] = active ? d_sigma * T(dt[i]) : T(0);
  }
}

}  // namespace redrive
