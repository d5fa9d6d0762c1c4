// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_time_offsets.h"

#include <cmath>

namespace redrive {
namespace {

constexpr double kSure = 3;  // standard deviations

/// What the adjustment found of a clock: how far it is from what is given, and how sure that is.
struct OffsetEstimate {
  int camera = 0, at = 0;  ///< at: in the covariance
  double moved_s = 0, variance = 0;
  bool told(double prior_s) const {
    const double sigma_s = std::sqrt(variance);
    return sigma_s <= max_observable_sigma_s(prior_s) || std::abs(moved_s) > kSure * sigma_s;
  }
};

/// Against the mean of the others, at least one. Variances are those with all terms independent,
/// times what this clock has more than that by itself.
OffsetEstimate against_others(const Eigen::MatrixXd& covariance,
                              const std::vector<OffsetEstimate>& clocks,
                              const OffsetEstimate& clock) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(covariance.rows());
  double moved_s = 0;
  for (const OffsetEstimate& other : clocks) {
    const double weight = other.at == clock.at ? 1 : -1 / static_cast<double>(clocks.size() - 1);
    weights[other.at] = weight;
    moved_s += weight * other.moved_s;
  }
  const double more = clock.variance / covariance(clock.at, clock.at);
  return {clock.camera, clock.at, moved_s, more * weights.dot(covariance * weights)};
}

}  // namespace

std::vector<UnobservableTimeOffset> unobservable_time_offsets(const RigModel& model,
                                                              const BundleResult& result,
                                                              const std::vector<int>& used,
                                                              double prior_s, bool lidar) {
  std::vector<OffsetEstimate> clocks;
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    const RigModelCamera& camera = model.cameras[c];
    if (used[c] > 0 && result.offset_index[c])
      clocks.push_back({static_cast<int>(c), *result.offset_index[c],
                        camera.offset_s - camera.initial_offset_s(),
                        result.variance[*result.offset_index[c]]});
  }
  if (!lidar && clocks.size() == 1) return {};
  std::vector<UnobservableTimeOffset> unobservable;
  for (const OffsetEstimate& clock : clocks) {
    if ((!result.contrast.empty() && result.contrast[clock.camera].told) || clock.told(prior_s))
      continue;
    if (clocks.size() > 1 && against_others(result.covariance, clocks, clock).told(prior_s))
      continue;
    unobservable.push_back(
        {clock.camera, model.cameras[clock.camera].offset_s, std::sqrt(clock.variance)});
  }
  return unobservable;
}

}  // namespace redrive
