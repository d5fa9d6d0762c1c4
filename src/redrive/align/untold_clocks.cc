// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/untold_clocks.h"

#include <cmath>

namespace redrive {
namespace {

constexpr double kSure = 3;  // standard deviations

/// What the adjustment found of a clock: how far it is from what is given, and how sure that is.
struct FoundClock {
  int camera = 0, at = 0;  ///< at: in the covariance
  double moved_s = 0, variance = 0;
  bool told(double prior_s) const {
    const double sigma_s = std::sqrt(variance);
    return sigma_s <= sigma_of_told_clock_s(prior_s) || std::abs(moved_s) > kSure * sigma_s;
  }
};

/// Against the mean of the others, at least one. Variances are those with all terms independent,
/// times what this clock has more than that by itself.
FoundClock against_others(const Eigen::MatrixXd& covariance, const std::vector<FoundClock>& clocks,
                          const FoundClock& clock) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(covariance.rows());
  double moved_s = 0;
  for (const FoundClock& other : clocks) {
    const double weight = other.at == clock.at ? 1 : -1 / static_cast<double>(clocks.size() - 1);
    weights[other.at] = weight;
    moved_s += weight * other.moved_s;
  }
  const double more = clock.variance / covariance(clock.at, clock.at);
  return {clock.camera, clock.at, moved_s, more * weights.dot(covariance * weights)};
}

}  // namespace

std::vector<UntoldClock> untold_clocks(const RigModel& model, const BundleResult& result,
                                       const std::vector<int>& used, double prior_s, bool lidar) {
  std::vector<FoundClock> clocks;
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    const RigModelCamera& camera = model.cameras[c];
    if (used[c] > 0 && result.offset_at[c])
      clocks.push_back({static_cast<int>(c), *result.offset_at[c],
                        camera.offset_s - camera.given_offset_s(),
                        result.variance[*result.offset_at[c]]});
  }
  if (!lidar && clocks.size() == 1) return {};
  std::vector<UntoldClock> untold;
  for (const FoundClock& clock : clocks) {
    if ((!result.contrast.empty() && result.contrast[clock.camera].told) || clock.told(prior_s))
      continue;
    if (clocks.size() > 1 && against_others(result.covariance, clocks, clock).told(prior_s))
      continue;
    untold.push_back(
        {clock.camera, model.cameras[clock.camera].offset_s, std::sqrt(clock.variance)});
  }
  return untold;
}

}  // namespace redrive
