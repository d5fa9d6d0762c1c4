// SPDX-License-Identifier: Apache-2.0
// Exposure and white balance of each camera over time: three colour gains, learned with the field,
// so that the field need not explain them by the position in space. For one ray, with adjoints.
//   gain_c(t) = exp(kLogGainScale * p_c(t)),
// p_c(t) linear between knots every kKnotSpacing_s seconds, constant before the first and after the
// last. Parameters [cameras, knots, 3]; all 0 means gains of 1.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "redrive/field/exposure.h"

namespace redrive {

/// Distance of the knots. Exposure control takes about as long to settle; held-out images between
/// two training images get interpolated gains.
constexpr float kKnotSpacing_s = 0.5f;
/// A log gain is this times its parameter, which lowers its learning rate against the field's.
constexpr float kLogGainScale = 0.05f;

struct AppearanceConfig {
  int cameras = 0, knots = 0;  ///< 0: no gains
  /// Weights the mean square of all log gains against the colour loss. Its gradient is about a
  /// hundredth of the colour loss's from the images of one camera.
  float regulariser_weight = 5e-4f;
  float knot_spacing_s = kKnotSpacing_s;

  std::size_t size() const { return 3 * static_cast<std::size_t>(cameras) * knots; }
};

/// The two knots around a time and the weight of the second.
struct KnotWeights {
  std::size_t first, second;  ///< index of the knot's red parameter in [cameras, knots, 3]
  float second_weight;
};
inline KnotWeights knots_at(const AppearanceConfig& config, const Exposure& exposure) {
  const float at =
      std::clamp(exposure.t_s / config.knot_spacing_s, 0.0f, static_cast<float>(config.knots - 1));
  const int first = static_cast<int>(at), second = std::min(first + 1, config.knots - 1);
  const std::size_t row = static_cast<std::size_t>(exposure.camera) * config.knots;
  return {3 * (row + first), 3 * (row + second), at - static_cast<float>(first)};
}

/// Returns the gains of r, g, b; 1 where exposure.camera is -1 or the model has no gains.
template <class T>
std::array<T, 3> colour_gains(const AppearanceConfig& config, const T* parameters,
                              const Exposure& exposure) {
  using std::exp;
  if (exposure.camera < 0 || config.size() == 0) return {T(1), T(1), T(1)};
  const KnotWeights at = knots_at(config, exposure);
  std::array<T, 3> gains;
  for (int k = 0; k < 3; ++k)
    gains[k] = exp(T(kLogGainScale) * (parameters[at.first + k] * T(1 - at.second_weight) +
                                       parameters[at.second + k] * T(at.second_weight)));
  return gains;
}

/// Calls add(index of the parameter, its derivative) for the two knots of each channel, from the
/// gains that colour_gains returned; the first knot first.
template <class T, class Add>
void colour_gains_adjoint(const AppearanceConfig& config, const Exposure& exposure,
                          const std::array<T, 3>& gains, const std::array<T, 3>& d_gains,
                          const Add& add) {
  if (exposure.camera < 0 || config.size() == 0) return;
  const KnotWeights at = knots_at(config, exposure);
  for (int k = 0; k < 3; ++k) {
    const T d = T(kLogGainScale) * gains[k] * d_gains[k];
    add(at.first + k, T(1 - at.second_weight) * d);
    add(at.second + k, T(at.second_weight) * d);
  }
}

/// One parameter's term of the regulariser regulariser_weight * mean over all parameters of
/// (log gain)^2, which keeps gains near 1.
template <class T>
struct GainRegulariser {
  T value, derivative;
};
template <class T>
GainRegulariser<T> gain_regulariser(const AppearanceConfig& config, T parameter) {
  const T factor(config.regulariser_weight * kLogGainScale * kLogGainScale /
                 static_cast<float>(config.size()));
  return {factor * parameter * parameter, T(2) * factor * parameter};
}

}  // namespace redrive
