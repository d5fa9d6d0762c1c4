// SPDX-License-Identifier: Apache-2.0
// For tests: LiDAR returns of the textured street.
#pragma once

#include "redrive/align/lidar/planes.h"
#include "redrive/scene/textured_drive_testing.h"

namespace redrive {

/// Returns of its LiDAR, 1 m ahead and 1.8 m up, from the same walls; intensities are the texture's
/// brightness.
inline std::vector<LidarSample> make_test_returns(const Recording& drive, int count) {
  const RigModel model = make_rig_model(drive);
  const std::int64_t first_ns = drive.frames.front().t_ns, last_ns = drive.frames.back().t_ns;
  std::vector<LidarSample> all;
  for (int i = 0; i < count; ++i) {
    const auto uniform = [&](int k, double a, double b) {
      return a +
             (b - a) * random_unit(random_key(11, kStreamTest, static_cast<std::uint64_t>(i)), k);
    };
    LidarSample sample;
    sample.t_ns = first_ns + (last_ns - first_ns) * (i / 100) / (count / 100);
    const Rigid3d pose = model.motion_at(sample.t_ns).world_from_body;
    const Eigen::Vector3d from = pose * Eigen::Vector3d(1, 0, 1.8);
    const Eigen::Vector3d direction(uniform(0, -1, 1), uniform(1, -1, 1), uniform(2, -0.6, 0.2));
    const Eigen::Vector3d hit = hit_street(from, direction.normalized());
    sample.in_body = pose.inverse(Eigen::Isometry) * hit;
    sample.intensity = static_cast<std::uint16_t>(std::lround(250 * street_texture(hit)));
    all.push_back(sample);
  }
  return all;
}

}  // namespace redrive
