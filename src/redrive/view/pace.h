// SPDX-License-Identifier: Apache-2.0
// Chooses how small an image must be to be rendered in time.
#pragma once

#include <algorithm>
#include <map>
#include <optional>

namespace redrive::view {

/// Measured rendering times of one camera by downscale factor, and choices that follow from them.
class Pace {
 public:
  static constexpr int kFirstFactor = 4;  ///< before anything was measured

  /// Takes the time of an image. A change at this factor, for example when other programs use the
  /// processor, is taken to hold for all.
  void measured(int factor, double seconds) {
    const auto [known, is_new] = seconds_.try_emplace(factor, std::max(seconds, 1e-6));
    if (is_new) return;
    const double smoothed = std::max(0.5 * (known->second + seconds), 1e-6);
    const double change = smoothed / known->second;
    for (auto& [other, time] : seconds_) time *= change;
  }

  /// Returns the time of an image at `factor`: measured, or the time of the nearest measured factor
  /// times the ratio of the pixels, which is too long where part of the work does not depend on the
  /// pixels. Nothing before anything was measured.
  std::optional<double> seconds(int factor) const {
    if (const auto known = seconds_.find(factor); known != seconds_.end()) return known->second;
    std::optional<double> best;
    for (const auto& [other, time] : seconds_) {
      const double ratio = static_cast<double>(other) / factor;
      const double estimate = time * std::max(1.0, ratio * ratio);
      best = best ? std::min(*best, estimate) : estimate;
    }
    return best;
  }

  /// Returns the smallest factor, at most `most`, whose image takes at most `budget_s`.
  int factor_within(double budget_s, int most) const {
    if (seconds_.empty()) return std::min(kFirstFactor, most);
    for (int factor = 1; factor < most; ++factor)
      if (*seconds(factor) <= budget_s) return factor;
    return most;
  }

 private:
  std::map<int, double> seconds_;
};

}  // namespace redrive::view
