// SPDX-License-Identifier: Apache-2.0
// Adam (Kingma and Ba, ICLR 2015, algorithm 1) of one parameter, and learning rate schedules.
#pragma once

#include <cmath>
#include <cstdint>
#include <span>

namespace redrive {

/// Constants of one step: m_hat = m * bias1, v_hat = v * bias2, bias = 1 / (1 - beta^step), step
/// counted from 1.
struct AdamStep {
  float learning_rate = 5e-4f, beta1 = 0.9f, beta2 = 0.999f, epsilon = 1e-8f;
  float bias1 = 1, bias2 = 1;
  bool lazy = false;  ///< skips a parameter whose gradient is exactly 0, its moments included: hash
                      ///< grid rows that no sample of the step touched
};

inline AdamStep adam_step(double learning_rate, std::int64_t step) {
  AdamStep s;
  s.learning_rate = static_cast<float>(learning_rate);
  s.bias1 = static_cast<float>(1.0 / (1.0 - std::pow(double(s.beta1), double(step))));
  s.bias2 = static_cast<float>(1.0 / (1.0 - std::pow(double(s.beta2), double(step))));
  return s;
}

/// Updates parameter, m and v: p -= learning_rate * m_hat / (sqrt(v_hat) + epsilon). A NaN or
/// infinite gradient makes the parameter NaN.
template <class T>
void adam_update(const AdamStep& s, T gradient, T& parameter, T& m, T& v) {
  using std::sqrt;
  if (s.lazy && gradient == T(0)) return;
  m = T(s.beta1) * m + T(1 - s.beta1) * gradient;
  v = T(s.beta2) * v + T(1 - s.beta2) * gradient * gradient;
  parameter -= T(s.learning_rate) * (m * T(s.bias1)) / (sqrt(v * T(s.bias2)) + T(s.epsilon));
}

/// MultiStepLR: returns initial * gamma^(number of milestones <= step), step counted from 0.
inline double multi_step_learning_rate(double initial, double gamma,
                                       std::span<const std::int64_t> milestones,
                                       std::int64_t step) {
  double rate = initial;
  for (const std::int64_t milestone : milestones)
    if (step >= milestone) rate *= gamma;
  return rate;
}

/// Returns initial * last_factor^progress, progress 0..1 through the run, with a linear warm-up
/// over the first warm_up_steps, while Adam's moments are averages of few gradients.
inline double exponential_decay_rate(double initial, double last_factor, double progress,
                                     std::int64_t step, std::int64_t warm_up_steps) {
  const double warm = step < warm_up_steps
                          ? static_cast<double>(step + 1) / static_cast<double>(warm_up_steps)
                          : 1.0;
  return initial * std::pow(last_factor, progress) * warm;
}

}  // namespace redrive
