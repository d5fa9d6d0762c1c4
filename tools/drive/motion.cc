// SPDX-License-Identifier: Apache-2.0
#include "tools/drive/motion.h"

#include <cmath>
#include <numbers>

#include "redrive/base/rng.h"
#include "redrive/math/angles.h"
#include "tools/drive/streams.h"

namespace redrive::drive {
namespace {

double wave(double amplitude, double period_s, double phase, double t_s) {
  return amplitude * std::sin(2 * std::numbers::pi * t_s / period_s + phase);
}

/// Box-Muller.
double normal(std::uint64_t key, std::uint64_t index) {
  return std::sqrt(-2 * std::log(1 - double(random_unit(key, 2 * index)))) *
         std::cos(2 * std::numbers::pi * random_unit(key, 2 * index + 1));
}

}  // namespace

double Motion::along_m(double t_s) const { return speed_m_s_ * t_s + wave(0.25, 3.7, 0, t_s); }

Eigen::Vector3d Motion::position(double t_s) const {
  constexpr double kLane_m = -kLaneEdge_m / 2;
  return road_.position(along_m(t_s), kLane_m + wave(0.16, 2.9, 0.4, t_s) + wave(0.12, 7.3, 1, t_s),
                        wave(0.008, 1.6, 0, t_s));
}

Rigid3d Motion::world_from_body(double t_s) const {
  constexpr double kStep_s = 0.02;
  const Eigen::Vector3d ahead = position(t_s + kStep_s) - position(t_s - kStep_s);
  const auto turn = [](double angle_rad, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(angle_rad, axis);
  };
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = position(t_s);
  const double pitch_deg = wave(0.2, 1.7, 1, t_s), roll_deg = wave(0.3, 2.3, 0.3, t_s) + 0.25;
  pose.linear() = (turn(std::atan2(ahead.y(), ahead.x()), Eigen::Vector3d::UnitZ()) *
                   turn(-std::atan(road_.slope(along_m(t_s))) - kRadiansPerDegree * pitch_deg,
                        Eigen::Vector3d::UnitY()) *
                   turn(kRadiansPerDegree * roll_deg, Eigen::Vector3d::UnitX()))
                      .toRotationMatrix();
  return pose;
}

Vector6d pose_error(unsigned seed, int frame) {
  // White noise filtered by a Gaussian of the width L / sqrt(2) has the correlation
  // exp(-t^2 / (2 L^2)).
  constexpr double kCorrelation_s = 0.7;
  constexpr int kReach = 15;  // frames: three widths
  const auto weight = [](int frames) {
    const double t_s = frames / kFrameRate_hz;
    return std::exp(-t_s * t_s / (kCorrelation_s * kCorrelation_s));
  };
  Vector6d sum = Vector6d::Zero();
  double squares = 0;
  for (int j = -kReach; j <= kReach; ++j) {
    const std::uint64_t key =
        random_key(seed, kStreamPoses, static_cast<std::uint64_t>(frame + j + kReach));
    for (int k = 0; k < 6; ++k) sum[k] += weight(j) * normal(key, static_cast<std::uint64_t>(k));
    squares += weight(j) * weight(j);
  }
  constexpr double kAngle_rad = 0.12 * kRadiansPerDegree;
  return sum.cwiseProduct(
             (Vector6d() << 0.06, 0.06, 0.03, kAngle_rad, kAngle_rad, kAngle_rad).finished()) /
         std::sqrt(squares);
}

}  // namespace redrive::drive
