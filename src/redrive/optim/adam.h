// SPDX-License-Identifier: Apache-2.0
// Adam (Kingma and Ba, ICLR 2015, algorithm 1), scalar; and the MultiStepLR schedule.
#pragma once

#include <cmath>
#include <cstdint>
#include <span>

#include "redrive/base/host_device.h"

namespace redrive {

/// One step's constants. m_hat = m * bias1, v_hat = v * bias2 with bias = 1 / (1 - beta^step), step
/// counted from 1.
struct AdamStep {
  float learning_rate = 5e-4f, beta1 = 0.9f, beta2 = 0.999f, epsilon = 1e-8f;
  float bias1 = 1, bias2 = 1;
  bool lazy = false;  ///< leaves a parameter alone, moments and all, in steps that say nothing of
                      ///< it (gradient 0)
};

inline AdamStep adam_step(double learning_rate, std::int64_t step) {
  AdamStep s;
  s.learning_rate = static_cast<float>(learning_rate);
  s.bias1 = static_cast<float>(1.0 / (1.0 - std::pow(double(s.beta1), double(step))));
  s.bias2 = static_cast<float>(1.0 / (1.0 - std::pow(double(s.beta2), double(step))));
  return s;
}

/// p -= lr * m_hat / (sqrt(v_hat) + epsilon).
template <class T>
REDRIVE_HD void adam_update(const AdamStep& s, T gradient, T& parameter, T& m, T& v) {
  using std::sqrt;
  if (s.lazy && gradient == T(0)) return;
  m = T(s.beta1) * m + T(1 - s.beta1) * gradient;
  v = T(s.beta2) * v + T(1 - s.beta2) * gradient * gradient;
  parameter -= T(s.learning_rate) * (m * T(s.bias1)) / (sqrt(v * T(s.bias2)) + T(s.epsilon));
}

/// Learning rate of step `step` (from 0): initial * gamma^(number of milestones <= step).
inline double multi_step_learning_rate(double initial, double gamma,
                                       std::span<const std::int64_t> milestones,
                                       std::int64_t step) {
  double rate = initial;
  for (const std::int64_t milestone : milestones)
    if (step >= milestone) rate *= gamma;
  return rate;
}

/// Exponential decay with a warm-up: initial * last_factor^progress, progress 0..1 through the run;
/// the first kWarmUpSteps rise linearly, since Adam's first moments are of few steps.
constexpr std::int64_t kWarmUpSteps = 100;
inline double exponential_decay_rate(double initial, double last_factor, double progress,
                                     std::int64_t step) {
  const double warm = step < kWarmUpSteps ? static_cast<double>(step + 1) / kWarmUpSteps : 1.0;
  return initial * std::pow(last_factor, progress) * warm;
}

}  // namespace redrive
