// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/register_trajectories.h"

#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include <Eigen/Dense>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"

namespace redrive {
namespace {

// Distance at which a rotation error weighs as much as the translation that it causes: the ratio of
// an egomotion's usual errors, 6 cm and 0.12 degrees.
constexpr double kArm_m = 30;

}  // namespace

TrajectoryRegistration register_trajectories(std::span<const FramePose> run,
                                             std::span<const FramePose> ground_truth,
                                             const std::filesystem::path& file) {
  std::map<std::int64_t, const FramePose*> by_id;
  for (const FramePose& frame : ground_truth) by_id[frame.id] = &frame;
  std::vector<std::pair<Rigid3d, Rigid3d>> pairs;
  for (const FramePose& frame : run)
    if (const auto found = by_id.find(frame.id); found != by_id.end())
      pairs.emplace_back(frame.global_from_body, found->second->global_from_body);
  if (pairs.empty()) throw InputError(file, "", "", "has no frame of the run");

  // Relative to the true middle: ECEF magnitudes would cost the rotation six digits.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& [of_run, true_pose] : pairs) middle += true_pose.translation();
  middle /= static_cast<double>(pairs.size());
  Eigen::Matrix3Xd from(3, 4 * pairs.size()), to(3, 4 * pairs.size());
  for (std::size_t i = 0; i < pairs.size(); ++i)
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector3d arm =
          k == 0 ? Eigen::Vector3d::Zero() : Eigen::Vector3d(kArm_m * Eigen::Vector3d::Unit(k - 1));
      from.col(4 * i + k) = pairs[i].second * arm - middle;
      to.col(4 * i + k) = pairs[i].first * arm - middle;
    }
  Rigid3d motion;
  motion.matrix() = Eigen::umeyama(from, to, /*with_scaling=*/false);

  TrajectoryRegistration alignment;
  alignment.run_from_ground_truth =
      Eigen::Translation3d(middle) * motion * Eigen::Translation3d(-middle);
  alignment.frames = static_cast<int>(pairs.size());
  alignment.translation_m = motion.translation().norm();
  alignment.rotation_deg = Eigen::AngleAxisd(motion.linear()).angle() * kDegreesPerRadian;
  double squares_m = 0, squares_rad = 0;
  for (const auto& [of_run, true_pose] : pairs) {
    const Rigid3d residual =
        (alignment.run_from_ground_truth * true_pose).inverse(Eigen::Isometry) * of_run;
    squares_m += residual.translation().squaredNorm();
    const double angle = Eigen::AngleAxisd(residual.linear()).angle();
    squares_rad += angle * angle;
  }
  alignment.residual_m = std::sqrt(squares_m / static_cast<double>(pairs.size()));
  alignment.residual_deg =
      std::sqrt(squares_rad / static_cast<double>(pairs.size())) * kDegreesPerRadian;
  return alignment;
}

nlohmann::json registration_to_json(const TrajectoryRegistration& registration) {
  return {{"translation_m", registration.translation_m},
          {"rotation_deg", registration.rotation_deg},
          {"residual_m", registration.residual_m},
          {"residual_deg", registration.residual_deg},
          {"frames", registration.frames}};
}

}  // namespace redrive
