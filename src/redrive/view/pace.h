// SPDX-License-Identifier: Apache-2.0
// How small an image is rendered, so that it is there in time.
#pragma once

#include <algorithm>
#include <map>
#include <optional>

namespace redrive::view {

/// Measured rendering times of one camera by downscale factor, and what follows from them.
class Pace {
 public:
  static constexpr int kLargestFactor = 16;
  static constexpr int kFirstFactor = 4;  ///< before anything was measured

  void measured(int factor, double seconds) {
    double& known = seconds_.try_emplace(factor, seconds).first->second;
    known += 0.5 * (seconds - known);  // follows the scene, smooths single delays
  }

  /// Returns the time of an image at `factor`: measured, or that of the nearest measured factor
  /// times the ratio of the pixels, which is too long where part of the work is that of the scene.
  /// Nothing before anything was measured.
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

  /// Returns the smallest factor whose image takes at most `budget_s`.
  int factor_within(double budget_s) const {
    if (seconds_.empty()) return kFirstFactor;
    for (int factor = 1; factor < kLargestFactor; ++factor)
      if (*seconds(factor) <= budget_s) return factor;
    return kLargestFactor;
  }

 private:
  std::map<int, double> seconds_;
};

}  // namespace redrive::view
