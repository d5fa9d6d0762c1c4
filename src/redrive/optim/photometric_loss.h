// SPDX-License-Identifier: Apache-2.0
// Photometric loss: the mean squared error of n_rays colours, L = 1 / (3 n_rays) sum (c -
// target)^2, dL/dc = 2 (c - target) / (3 n_rays); and the Huber loss of a ray's colour.
#pragma once

#include <cmath>
#include <cstddef>
#include <span>

namespace redrive {

template <class T>
struct PhotometricTerm {
  T value;       ///< this channel's term of the batch's loss
  T derivative;  ///< with respect to the rendered channel
};

template <class T>
PhotometricTerm<T> photometric_term(T rendered, T target, int n_rays) {
  const T scale = T(1) / T(3.0 * n_rays), error = rendered - target;
  return {error * error * scale, T(2) * error * scale};
}

/// Returns the loss of a batch and writes d_rgb. rgb, target and d_rgb have 3 n_rays values in the
/// same order; summed in double, in that order.
inline double photometric_batch(std::span<const float> rgb, std::span<const float> target,
                                int n_rays, std::span<float> d_rgb) {
  double loss = 0;
  for (std::size_t i = 0; i < rgb.size(); ++i) {
    const auto term = photometric_term<double>(rgb[i], target[i], n_rays);
    loss += term.value;
    d_rgb[i] = static_cast<float>(term.derivative);
  }
  return loss;
}

/// Huber loss (Huber 1964) of a ray's colour, delta in units of colour: the squared error e^2 up to
/// e = delta, 2 delta e - delta^2 beyond it. The gradient of outliers, such as objects that move
/// through a few images, is bounded.
template <class T>
struct HuberTerm {
  T value;   ///< replaces the squared error, the sum over the channels
  T factor;  ///< multiplies the derivative of the squared error, in (0, 1]
};
template <class T>
HuberTerm<T> huber_term(T squared_error, T delta) {
  using std::sqrt;
  if (!(squared_error > delta * delta)) return {squared_error, T(1)};  // NaN reaches the loss
  const T distance = sqrt(squared_error);
  return {delta * (T(2) * distance - delta), delta / distance};
}

}  // namespace redrive
