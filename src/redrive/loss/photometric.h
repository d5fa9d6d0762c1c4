// SPDX-License-Identifier: Apache-2.0
// Mean squared error of a batch of n_rays colours: L = 1 / (3 n) sum (c - target)^2, dL/dc = 2 (c - target) / (3 n).
#pragma once

#include <cstddef>
#include <span>

namespace redrive {

template <class T>
struct PhotometricTerm {
  T value;       ///< this channel's share of the batch's loss
  T derivative;  ///< with respect to the rendered channel
};

template <class T>
PhotometricTerm<T> photometric_term(T rendered, T target, int n_rays) {
  const T scale = T(1) / T(3.0 * n_rays), error = rendered - target;
  return {error * error * scale, T(2) * error * scale};
}

/// The whole batch, in one order: returns its loss and fills d_rgb; all three [3, n_rays], whatever the order inside.
inline double photometric_batch(std::span<const float> rgb, std::span<const float> target, int n_rays,
                                std::span<float> d_rgb) {
  double loss = 0;
  for (std::size_t i = 0; i < rgb.size(); ++i) {
    const auto term = photometric_term<double>(rgb[i], target[i], n_rays);
    loss += term.value;
    d_rgb[i] = static_cast<float>(term.derivative);
  }
  return loss;
}

}  // namespace redrive
