// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_extrinsics.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "redrive/math/angles.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

constexpr double kSignificantSigmas = 3;  // standard deviations
// largest sigma of an extrinsic that counts as observable
constexpr double kMaxSigma_m = 0.02, kMaxSigma_rad = 0.1 * kRadiansPerDegree;
// Errors that observations share: lens models, shapes of surfaces, a LiDAR's own calibration.
// rotation of the camera relative to the car
constexpr double kMotion_rad = 0.02 * kRadiansPerDegree,
                 kMotion_m = 0.002,  // motion across the driving direction
    kTied_rad = 0.013 * kRadiansPerDegree, kTied_m = 0.004;
constexpr int kMinTies = 50;  // fewer may share one wrong surface

/// Mean square, over the frames, of the part of the car's rotation and position about their means
/// that is perpendicular to `axis` of the body.
struct Excitation {
  double rad2 = 0, m2 = 0;
};

Excitation excitation_across(const RigModel& model, const Eigen::Vector3d& axis) {
  const auto n = static_cast<double>(model.initial_frames.size());
  const Eigen::Matrix3d body_from_world =
      model.initial_frames[model.initial_frames.size() / 2].world_from_body.linear().transpose();
  std::vector<Eigen::Vector3d> rotations, positions;
  Eigen::Vector3d mean_rotation = Eigen::Vector3d::Zero(), mean_position = mean_rotation;
  for (const PosedFrame& frame : model.initial_frames) {
    rotations.push_back(so3_log(body_from_world * frame.world_from_body.linear()));
    positions.push_back(body_from_world * frame.world_from_body.translation());
    mean_rotation += rotations.back() / n;
    mean_position += positions.back() / n;
  }
  Excitation sum;
  for (std::size_t f = 0; f < rotations.size(); ++f) {
    sum.rad2 += axis.cross(rotations[f] - mean_rotation).squaredNorm() / n;
    sum.m2 += axis.cross(positions[f] - mean_position).squaredNorm() / n;
  }
  return sum;
}

double variance_along(const Eigen::VectorXd& weights, const BundleResult& result) {
  return std::max(weights.dot(result.covariance * weights),
                  weights.dot(result.robust_covariance * weights));
}

/// Weights of a camera's number in the covariance.
Eigen::VectorXd weights_of(const RigModel& model, const BundleResult& result, int camera,
                           int axis) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(result.covariance.rows());
  const auto at = static_cast<Eigen::Index>(6 * (model.initial_frames.size() + camera));
  weights.segment<6>(at) = body_axis_of_extrinsics(model.cameras[camera], axis);
  return weights;
}

bool is_observable(double change, double sigma, double prior, int axis) {
  const double max_sigma = axis < 3 ? kMaxSigma_m : kMaxSigma_rad;
  return sigma <= prior / 2 ||
         (std::abs(change) > kSignificantSigmas * sigma && sigma <= max_sigma);
}

/// Whether the number is observable relative to the mean of the other cameras'.
bool is_observable_against_others(const RigModel& model, const BundleResult& result,
                                  const std::vector<int>& cameras, int camera, int axis,
                                  double prior) {
  if (cameras.size() < 2) return false;
  const double of_other = -1 / static_cast<double>(cameras.size() - 1);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(result.covariance.rows());
  double change = 0;
  for (const int other : cameras) {
    const double weight = other == camera ? 1 : of_other;
    weights += weight * weights_of(model, result, other, axis);
    change += weight * extrinsics_in_body(model.cameras[other])[axis];
  }
  const double sigma =
      std::hypot(std::sqrt(variance_along(weights, result)), axis < 3 ? kTied_m : kTied_rad);
  return is_observable(change, sigma, prior, axis);
}

}  // namespace

const char* extrinsic_name(int axis) {
  constexpr std::array kNames{"forward", "left", "up", "roll", "pitch", "yaw"};
  return kNames.at(axis);
}

Vector6d body_axis_of_extrinsics(const RigModelCamera& camera, int axis) {
  Vector6d direction = Vector6d::Zero();
  const Eigen::Vector3d row = camera.initial.body_from_sensor.linear().row(axis % 3);
  direction.segment<3>(axis < 3 ? 0 : 3) = row;
  return direction;
}

Vector6d extrinsics_in_body(const RigModelCamera& camera) {
  Vector6d values;
  for (int axis = 0; axis < kExtrinsicAxes; ++axis)
    values[axis] = body_axis_of_extrinsics(camera, axis).dot(camera.extrinsics);
  return values;
}

double model_error(const RigModel& model, int axis, int ties) {
  const Excitation across = excitation_across(model, Eigen::Vector3d::Unit(axis % 3));
  const bool tied = ties >= kMinTies;
  const auto square = [](double x) { return x * x; };
  const double information = axis < 3
                                 ? across.rad2 / square(kMotion_m) + tied / square(kTied_m)
                                 : across.rad2 / square(kMotion_rad) +
                                       across.m2 / square(kMotion_m) + tied / square(kTied_rad);
  return 1 / std::sqrt(std::max(information, 1e-12));
}

double tie_error_m(int ties) { return ties >= kMinTies ? kTied_m : 0; }

double extrinsic_sigma(const RigModel& model, const BundleResult& result, const Vector6d& prior,
                       int camera, int axis) {
  const double sigma =
      std::hypot(std::sqrt(variance_along(weights_of(model, result, camera, axis), result)),
                 model_error(model, axis, result.ties_of_camera[camera]));
  const double change = extrinsics_in_body(model.cameras[camera])[axis];
  return std::min(sigma, std::max(prior[axis], std::abs(change)));
}

std::vector<UnobservableExtrinsic> unobservable_extrinsics(const RigModel& model,
                                                           const BundleResult& result,
                                                           const std::vector<int>& used,
                                                           const Vector6d& prior) {
  std::vector<int> cameras;
  for (std::size_t c = 0; c < model.cameras.size(); ++c)
    if (used[c] > 0) cameras.push_back(static_cast<int>(c));
  std::vector<UnobservableExtrinsic> unobservable;
  for (const int camera : cameras)
    for (int axis = 0; axis < kExtrinsicAxes; ++axis) {
      const double change = extrinsics_in_body(model.cameras[camera])[axis],
                   sigma = extrinsic_sigma(model, result, prior, camera, axis);
      if (is_observable(change, sigma, prior[axis], axis) ||
          is_observable_against_others(model, result, cameras, camera, axis, prior[axis]))
        continue;
      unobservable.push_back({camera, axis, change, sigma});
    }
  return unobservable;
}

void reset_extrinsic(RigModelCamera* camera, int axis) {
  const Vector6d direction = body_axis_of_extrinsics(*camera, axis);  // unit
  camera->extrinsics -= direction * direction.dot(camera->extrinsics);
}

}  // namespace redrive
