// SPDX-License-Identifier: Apache-2.0
// Mean squared error of a batch of n_rays colours: L = 1 / (3 n) sum (c - target)^2, dL/dc = 2 (c - target) / (3 n).
#pragma once

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

}  // namespace redrive
