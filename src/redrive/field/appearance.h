// SPDX-License-Identifier: Apache-2.0
// What a camera makes of light over time: gains of the three colours, for exposure and white
// balance, learned with the field so that it need not explain them by places. Scalar, one ray, and
// the adjoint.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "redrive/base/host_device.h"
#include "redrive/field/exposure.h"

namespace redrive {

/// Log gains stand every kKnotSpacing_s of each camera's drive, linear between them: exposure
/// control takes about as long, and what lies between training pictures has its gains, too.
constexpr float kKnotSpacing_s = 0.5f;
/// A log gain is so many times its parameter, which slows it down against the field's.
constexpr float kLogGainScale = 0.05f;
/// Of the mean square of all log gains against the colours' loss: a hundredth of what a camera's
/// pictures say of one.
constexpr float kGainRegulariserWeight = 5e-4f;

struct AppearanceConfig {
  int cameras = 0, knots = 0;  ///< 0: none

  REDRIVE_HD std::size_t size() const { return 3 * static_cast<std::size_t>(cameras) * knots; }
};

/// The two knots around a time, and the second one's share.
struct KnotWeights {
  std::size_t first, second;  ///< of their red in [cameras, knots, 3]
  float of_second;
};
REDRIVE_HD inline KnotWeights knots_at(const AppearanceConfig& config, const Exposure& exposure) {
  const float at =
      std::clamp(exposure.t_s / kKnotSpacing_s, 0.0f, static_cast<float>(config.knots - 1));
  const int first = static_cast<int>(at), second = std::min(first + 1, config.knots - 1);
  const std::size_t row = static_cast<std::size_t>(exposure.camera) * config.knots;
  return {3 * (row + first), 3 * (row + second), at - static_cast<float>(first)};
}

/// Factors of r, g, b; 1 where exposure.camera is -1 or there is no appearance.
template <class T>
REDRIVE_HD std::array<T, 3> colour_gains(const AppearanceConfig& config, const T* parameters,
                                         const Exposure& exposure) {
  using std::exp;
  if (exposure.camera < 0 || config.size() == 0) return {T(1), T(1), T(1)};
  const KnotWeights at = knots_at(config, exposure);
  std::array<T, 3> gains;
  for (int k = 0; k < 3; ++k)
    gains[k] = exp(T(kLogGainScale) * (parameters[at.first + k] * T(1 - at.of_second) +
                                       parameters[at.second + k] * T(at.of_second)));
  return gains;
}

/// From gains as colour_gains gave them: calls add(number of the parameters, its derivative), first
/// knot first.
template <class T, class Add>
REDRIVE_HD void colour_gains_adjoint(const AppearanceConfig& config, const Exposure& exposure,
                                     const std::array<T, 3>& gains, const std::array<T, 3>& d_gains,
                                     const Add& add) {
  if (exposure.camera < 0 || config.size() == 0) return;
  const KnotWeights at = knots_at(config, exposure);
  for (int k = 0; k < 3; ++k) {
    const T d = T(kLogGainScale) * gains[k] * d_gains[k];
    add(at.first + k, T(1 - at.of_second) * d);
    add(at.second + k, T(at.of_second) * d);
  }
}

/// A parameter's share of the loss that keeps gains near 1: kGainRegulariserWeight times the mean
/// square of all log gains.
template <class T>
struct GainRegulariser {
  T value, derivative;
};
template <class T>
REDRIVE_HD GainRegulariser<T> gain_regulariser(const AppearanceConfig& config, T parameter) {
  const T factor(kGainRegulariserWeight * kLogGainScale * kLogGainScale /
                 static_cast<float>(config.size()));
  return {factor * parameter * parameter, T(2) * factor * parameter};
}

}  // namespace redrive
