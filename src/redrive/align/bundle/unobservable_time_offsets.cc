// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_time_offsets.h"

#include <algorithm>
#include <cmath>

#include "redrive/align/bundle/unobservable_extrinsics.h"

namespace redrive {
namespace {

constexpr double kSignificant = 3;          // standard deviations
constexpr double kMinSpeed_m_per_s = 1e-3;  // slower is at rest

double mean_speed_m_per_s(const RigModel& model) {
  double path_m = 0;
  for (std::size_t f = 1; f < model.initial_frames.size(); ++f)
    path_m += (model.initial_frames[f].world_from_body.translation() -
               model.initial_frames[f - 1].world_from_body.translation())
                  .norm();
  const std::int64_t duration_ns =
      model.initial_frames.back().t_ns - model.initial_frames.front().t_ns;
  return path_m / (1e-9 * static_cast<double>(duration_ns));
}

/// Error of a time offset that all ties of the camera share.
double shared_error_s(const RigModel& model, const BundleResult& result, int camera) {
  const double error_m =
      result.ties_of_camera.empty() ? 0 : tie_error_m(result.ties_of_camera[camera]);
  return error_m == 0 ? 0 : error_m / std::max(kMinSpeed_m_per_s, mean_speed_m_per_s(model));
}

/// The change of a time offset from its initial value, its variance from the residuals, and the
/// error that is added to it.
struct OffsetEstimate {
  int camera = 0, index = 0;  ///< index: in the covariance
  double change_s = 0, variance = 0, shared_s = 0;
  double sigma_s() const { return std::hypot(std::sqrt(std::max(0.0, variance)), shared_s); }
  bool observable(double prior_s) const {
    const double sigma_s = this->sigma_s();
    return sigma_s <= max_observable_sigma_s(prior_s) ||
           std::abs(change_s) > kSignificant * sigma_s;
  }
};

/// The estimate relative to the mean of the others, at least one. Its variance is the variance of
/// independent residuals, scaled like the robust variance of the offset itself.
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
  return {offset.camera, offset.index, change_s, more * weights.dot(covariance * weights), 0};
}

OffsetEstimate estimate_of(const RigModel& model, const BundleResult& result, int camera) {
  const RigModelCamera& of_rig = model.cameras[camera];
  const int index = *result.offset_index[camera];
  return {camera, index, of_rig.offset_s - of_rig.initial_offset_s(), result.variance[index],
          shared_error_s(model, result, camera)};
}

}  // namespace

std::optional<double> time_offset_sigma(const RigModel& model, const BundleResult& result,
                                        double prior_s, int camera) {
  if (!result.offset_index[camera]) return std::nullopt;
  const OffsetEstimate estimate = estimate_of(model, result, camera);
  return std::min(estimate.sigma_s(), std::max(prior_s, std::abs(estimate.change_s)));
}

std::vector<UnobservableTimeOffset> unobservable_time_offsets(const RigModel& model,
                                                              const BundleResult& result,
                                                              const std::vector<int>& used,
                                                              double prior_s, bool lidar) {
  std::vector<OffsetEstimate> offsets;
  for (std::size_t c = 0; c < model.cameras.size(); ++c)
    if (used[c] > 0 && result.offset_index[c])
      offsets.push_back(estimate_of(model, result, static_cast<int>(c)));
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
        {offset.camera, model.cameras[offset.camera].offset_s, offset.sigma_s()});
  }
  return unobservable;
}

}  // namespace redrive
