// SPDX-License-Identifier: Apache-2.0
// Mean squared error of a batch of n_rays colours: L = 1 / (3 n) sum (c - target)^2, dL/dc = 2 (c -
// target) / (3 n).
#pragma once

#include <cmath>
#include <cstddef>
#include <span>

#include "redrive/base/host_device.h"

namespace redrive {

template <class T>
struct PhotometricTerm {
  T value;       ///< this channel's share of the batch's loss
  T derivative;  ///< with respect to the rendered channel
};

template <class T>
REDRIVE_HD PhotometricTerm<T> photometric_term(T rendered, T target, int n_rays) {
  const T scale = T(1) / T(3.0 * n_rays), error = rendered - target;
  return {error * error * scale, T(2) * error * scale};
}

/// The whole batch, in one order: returns its loss and fills d_rgb; all three [3, n_rays], whatever
/// the order inside.
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

/// A ray's colour that is further off than `edge` counts by its distance and no longer by its
/// square (Huber 1964), so that what moved through a few pictures does not pull the place behind it
/// to its own colour.
template <class T>
struct HuberTerm {
  T value;   ///< instead of the ray's squared error, the sum over its channels
  T factor;  ///< of that squared error's derivative
};
template <class T>
REDRIVE_HD HuberTerm<T> huber_term(T squared_error, T edge) {
  using std::sqrt;
  if (!(squared_error > edge * edge)) return {squared_error, T(1)};  // NaN goes on into the loss
  const T distance = sqrt(squared_error);
  return {edge * (T(2) * distance - edge), edge / distance};
}

}  // namespace redrive
