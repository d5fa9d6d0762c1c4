// SPDX-License-Identifier: Apache-2.0
// For tests of loop closures: a car drives around a block of houses more than once, and its
// odometry drifts.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "redrive/align/lidar/register_maps.h"
#include "redrive/base/rng.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/recording.h"

namespace redrive::testing {

/// Points of a road of radius kRadius_m around a block, of houses to both sides, and of poles.
class MadeBlock {
 public:
  static constexpr double kRadius_m = 40;

  MadeBlock() {
    for (int i = 0; i < 40'000; ++i) {
      const double angle = uniform(0, 2 * std::numbers::pi), radius = uniform(15, 65);
      points_.emplace_back(radius * std::cos(angle), radius * std::sin(angle),
                           0.002 * radius * std::sin(3 * angle));
    }
    for (int house = 0; house < 60; ++house) {
      const double angle = 2 * std::numbers::pi * (house + uniform(-0.4, 0.4)) / 60,
                   radius = house % 2 ? uniform(47, 55) : uniform(26, 33), half = uniform(1, 3),
                   height = uniform(1, 7), yaw = uniform(-0.3, 0.3) + angle;
      for (int i = 0; i < 700; ++i) {
        const double along = uniform(-half, half), side = i % 2 ? half : -half;
        Eigen::Vector3d p =
            i % 4 < 2 ? Eigen::Vector3d(along, side, 0) : Eigen::Vector3d(side, along, 0);
        p = so3_exp({0, 0, yaw}) * p;
        points_.push_back(p + Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle),
                                              uniform(0, height)));
      }
    }
  }

  /// Noisy points within 35 m of a place.
  PointMap seen_from(const Eigen::Vector3d& place, std::uint64_t pass) const {
    PointMap seen;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if ((points_[i] - place).norm() > 35) continue;
      const std::uint64_t key = random_key(3, kStreamTest, 1000 * pass + i % 7);
      Eigen::Vector3d noise;
      for (int d = 0; d < 3; ++d) noise[d] = 0.04 * (random_unit(key, 3 * i + d) - 0.5);
      seen.push_back(points_[i] + noise);
    }
    return seen;
  }

 private:
  double uniform(double low, double high) {
    return low + (high - low) * random_unit(random_key(1, kStreamTest), drawn_++);
  }
  std::uint64_t drawn_ = 0;
  std::vector<Eigen::Vector3d> points_;
};

/// `laps` around it, a frame a metre; the second lap is 1.5 m further out.
inline std::vector<FramePose> drive_around(double laps) {
  std::vector<FramePose> frames;
  const int n = static_cast<int>(laps * 2 * std::numbers::pi * MadeBlock::kRadius_m);
  for (int f = 0; f < n; ++f) {
    const double angle = f / MadeBlock::kRadius_m,
                 radius =
                     MadeBlock::kRadius_m + 1.5 * std::min(angle / (2 * std::numbers::pi), 1.0);
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp({0, 0, angle + std::numbers::pi / 2});
    pose.translation() = Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), 1);
    frames.push_back({100 + f, 100'000'000ll * f, pose});
  }
  return frames;
}

/// Returns the poses that an odometry reports which drifts in yaw by so many radians a metre.
inline std::vector<FramePose> drifted(const std::vector<FramePose>& exact, double turned) {
  std::vector<FramePose> frames{exact.front()};
  for (std::size_t f = 1; f < exact.size(); ++f) {
    Rigid3d step =
        exact[f - 1].global_from_body.inverse(Eigen::Isometry) * exact[f].global_from_body;
    step.linear() = step.linear() * so3_exp({0, 0, turned});
    FramePose frame = exact[f];
    frame.global_from_body = frames.back().global_from_body * step;
    frames.push_back(frame);
  }
  return frames;
}

}  // namespace redrive::testing
