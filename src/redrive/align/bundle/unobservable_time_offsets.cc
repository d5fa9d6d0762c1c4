// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_time_offsets.h"

#include <cmath>

namespace redrive {
namespace {

constexpr double kSignificant = 3;  // standard deviations

/// The change of a time offset from its initial value, and its variance.
struct OffsetEstimate {
  int camera = 0, index = 0;  ///< index: in the covariance
  double change_s = 0, variance = 0;
  bool observable(double prior_s) const {
    const double sigma_s = std::sqrt(variance);
    return sigma_s <= max_observable_sigma_s(prior_s) ||
           std::abs(change_s) > kSignificant * sigma_s;
  }
};

/// The estimate relative to the mean of the others, of which there is at least one. Its variance is
/// that of independent residuals, scaled as the robust variance of the offset itself is.
OffsetEstimate against_others(const Eigen::MatrixXd& covariance,
                              const std::vector<OffsetEstimate>& offsets,
                              const OffsetEstimate& offset) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(covariance.rows());
  double change_s = 0;
  for (const OffsetEstimate& other : offsets) {
    const double weight =
        other.index == offset.index ? 1 : -1 / static_cast<double>(offsets.size() - 1);
    weights[other.index] = weight;
    change_s += weight * other.change_s;
  }
  const double more = offset.variance / covariance(offset.index, offset.index);
  return {offset.camera, offset.index, change_s, more * weights.dot(covariance * weights)};
}

}  // namespace

std::vector<UnobservableTimeOffset> unobservable_time_offsets(const RigModel& model,
                                                              const BundleResult& result,
                                                              const std::vector<int>& used,
                                                              double prior_s, bool lidar) {
  std::vector<OffsetEstimate> offsets;
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    const RigModelCamera& camera = model.cameras[c];
    if (used[c] > 0 && result.offset_index[c])
      offsets.push_back({static_cast<int>(c), *result.offset_index[c],
                         camera.offset_s - camera.initial_offset_s(),
                         result.variance[*result.offset_index[c]]});
  }
  if (!lidar && offsets.size() == 1) return {};
  std::vector<UnobservableTimeOffset> unobservable;
  for (const OffsetEstimate& offset : offsets) {
    if ((!result.contrast.empty() && result.contrast[offset.camera].observable) ||
        offset.observable(prior_s))
      continue;
    if (offsets.size() > 1 &&
        against_others(result.covariance, offsets, offset).observable(prior_s))
      continue;
    unobservable.push_back(
        {offset.camera, model.cameras[offset.camera].offset_s, std::sqrt(offset.variance)});
  }
  return unobservable;
}

}  // namespace redrive
