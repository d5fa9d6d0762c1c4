// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/cost_functions.h"

#include <variant>

#include <ceres/sized_cost_function.h>

#include "redrive/math/dual.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

using Eigen::Map;
using Eigen::Matrix3d;
using Eigen::Vector3d;

/// A block of Ceres' Jacobian.
template <int kRows, int kColumns>
Map<Eigen::Matrix<double, kRows, kColumns, kColumns == 1 ? Eigen::ColMajor : Eigen::RowMajor>>
block(double* values) {
  return Map<
      Eigen::Matrix<double, kRows, kColumns, kColumns == 1 ? Eigen::ColMajor : Eigen::RowMajor>>(
      values);
}

/// The correction between two frames.
struct InterpolatedCorrection {
  Vector6d value, rate;  ///< rate: per second
  double weight;
};

InterpolatedCorrection interpolate(const double* a, const double* b, const LocalMotion& motion,
                                   double later_s) {
  const Map<const Vector6d> from(a), to(b);
  InterpolatedCorrection out;
  out.weight = motion.weight + later_s / motion.duration_s;
  out.value = from + out.weight * (to - from);
  out.rate = (to - from) / motion.duration_s;
  return out;
}

/// Normalised projection and its Jacobian; false outside the valid region of the camera model.
bool project(const CameraModel& model, const Vector3d& point, Eigen::Vector2d* projected,
             Eigen::Matrix<double, 2, 3>* jacobian) {
  const std::array<Dual, 3> p{Dual(point.x(), 0), Dual(point.y(), 1), Dual(point.z(), 2)};
  const auto m =
      std::visit([&](const auto& camera) { return camera.template project<Dual>(p); }, model);
  if (!m) return false;
  for (int i = 0; i < 2; ++i) {
    (*projected)[i] = (*m)[i].value;
    for (int k = 0; k < 3; ++k) (*jacobian)(i, k) = (*m)[i].d[k];
  }
  return true;
}

// In homogeneous coordinates (x, w) with w the inverse depth, so that nothing divides by it:
//   y = exp(angular_velocity s)^T (R^T (x - w p) - w velocity s)  initial pose(t + s)^-1
//   b = exp(phi)^T (y - w rho)                            in the body
//   c = exp(epsilon)^T (S^T (b - w m) - w eta)            in the camera
class ReprojectionCost final : public ceres::SizedCostFunction<2, 6, 6, 6, 1, 1, 3, 3> {
 public:
  ReprojectionCost(const RigModelCamera& camera, const LocalMotion& motion,
                   const Eigen::Vector2d& pixel, double sigma_px, const InverseDepthPoint& point)
      : camera_(camera),
        motion_(motion),
        offset_s_(camera.offset_s),
        readout_s_(camera.readout_s),
        after_middle_(camera.from_middle_line(pixel)),
        pixel_(pixel),
        sigma_px_(sigma_px) {
    const Rigid3d& pose = motion.world_from_body;
    axes_ = pose.linear().transpose() * point.axes;
    anchor_ = pose.linear().transpose() * (point.anchor - pose.translation());
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const double later_s =
        parameters[3][0] - offset_s_ + after_middle_ * (parameters[4][0] - readout_s_);
    const InterpolatedCorrection correction =
        interpolate(parameters[0], parameters[1], motion_, later_s);
    const Map<const Vector6d> extrinsics(parameters[2]);
    const Map<const Vector3d> intrinsics(parameters[5]), point(parameters[6]);
    const double w = point.z();
    const Matrix3d unturn = so3_exp(motion_.angular_velocity * later_s).transpose(),
                   unphi = so3_exp(correction.value.tail<3>()).transpose(),
                   unepsilon = so3_exp(extrinsics.tail<3>()).transpose(),
                   sensor_from_body = camera_.initial.body_from_sensor.linear().transpose();
    const Vector3d rho = correction.value.head<3>(),
                   sensor_in_body = camera_.initial.body_from_sensor.translation();
    const Vector3d direction = axes_ * Vector3d(point.x(), point.y(), 1);
    const Vector3d y = unturn * (direction + w * (anchor_ - motion_.velocity * later_s));
    const Vector3d b = unphi * (y - w * rho);
    const Vector3d c =
        unepsilon * (sensor_from_body * (b - w * sensor_in_body) - w * extrinsics.head<3>());

    Eigen::Vector2d seen;
    Eigen::Matrix<double, 2, 3> slope;
    if (!project(camera_.camera.model, c, &seen, &slope)) {
      residuals[0] = residuals[1] = kUnseen;
      constexpr int kSizes[] = {6, 6, 6, 1, 1, 3, 3};
      for (int k = 0; jacobians && k < 7; ++k)
        if (jacobians[k]) std::fill_n(jacobians[k], 2 * kSizes[k], 0.0);
      return true;
    }
    const Eigen::Vector2d focal((1 + intrinsics.x()) * camera_.camera.fx,
                                (1 + intrinsics.x()) * camera_.camera.fy);
    Map<Eigen::Vector2d> residual(residuals);
    residual = (focal.cwiseProduct(seen) + Eigen::Vector2d(camera_.camera.cx, camera_.camera.cy) +
                intrinsics.tail<2>() - pixel_) /
               sigma_px_;
    if (!jacobians) return true;

    const Eigen::Matrix<double, 2, 3> by_c = focal.asDiagonal() * slope / sigma_px_;
    const Eigen::Matrix<double, 2, 3> by_b = by_c * unepsilon * sensor_from_body;
    Eigen::Matrix<double, 2, 6> by_correction;
    by_correction << -w * by_b * unphi,
        by_b * skew(b) * so3_right_jacobian(correction.value.tail<3>());
    if (jacobians[0]) block<2, 6>(jacobians[0]) = (1 - correction.weight) * by_correction;
    if (jacobians[1]) block<2, 6>(jacobians[1]) = correction.weight * by_correction;
    if (jacobians[2])
      block<2, 6>(jacobians[2]) << -w * by_c * unepsilon,
          by_c * skew(c) * so3_right_jacobian(extrinsics.tail<3>());
    if (jacobians[3] || jacobians[4]) {
      const Eigen::Vector2d by_time =
          by_b * unphi * (y.cross(motion_.angular_velocity) - w * (unturn * motion_.velocity)) +
          by_correction * correction.rate;
      if (jacobians[3]) block<2, 1>(jacobians[3]) = by_time;
      if (jacobians[4]) block<2, 1>(jacobians[4]) = after_middle_ * by_time;
    }
    if (jacobians[5]) {
      auto by_intrinsics = block<2, 3>(jacobians[5]);
      by_intrinsics.col(0) =
          Eigen::Vector2d(camera_.camera.fx, camera_.camera.fy).cwiseProduct(seen) / sigma_px_;
      by_intrinsics.rightCols<2>() = Eigen::Matrix2d::Identity() / sigma_px_;
    }
    if (jacobians[6]) {
      const Matrix3d body_by_x = unphi * unturn;
      const Vector3d c_by_w =
          unepsilon *
          (sensor_from_body *
               (unphi * (unturn * (anchor_ - motion_.velocity * later_s) - rho) - sensor_in_body) -
           extrinsics.head<3>());
      auto by_point = block<2, 3>(jacobians[6]);
      by_point.leftCols<2>() = by_b * body_by_x * axes_.leftCols<2>();
      by_point.col(2) = by_c * c_by_w;
    }
    return true;
  }

 private:
  // initial values; the solver passes the present ones as parameters
  const RigModelCamera& camera_;
  LocalMotion motion_;
  double offset_s_, readout_s_, after_middle_;
  Eigen::Vector2d pixel_;
  double sigma_px_;
  Matrix3d axes_;    // the point's axes in the initial body's axes
  Vector3d anchor_;  // likewise
};

class PointToPlaneCost final : public ceres::SizedCostFunction<1, 6, 6, 3, 1> {
 public:
  PointToPlaneCost(const LocalMotion& motion, const RaisedReturn& in_body, double sigma_m,
                   const PlaneParameters& plane)
      : motion_(motion),
        in_body_(in_body),
        sigma_m_(sigma_m),
        centre_(plane.centre),
        axes_(plane.axes) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const InterpolatedCorrection correction = interpolate(parameters[0], parameters[1], motion_, 0);
    const Map<const Vector3d> plane(parameters[2]);
    const Matrix3d rotation = so3_exp(correction.value.tail<3>());
    const Vector3d in_body = in_body_.at(parameters[3][0]);
    const Vector3d from_centre =
        motion_.world_from_body * (rotation * in_body + correction.value.head<3>()) - centre_;
    const Vector3d normal = axes_ * Vector3d(plane.x(), plane.y(), 1);
    residuals[0] = (normal.dot(from_centre) - plane.z()) / sigma_m_;
    if (!jacobians) return true;
    const Eigen::RowVector3d by_body =
        normal.transpose() * motion_.world_from_body.linear() / sigma_m_;
    Eigen::Matrix<double, 1, 6> by_correction;
    by_correction << by_body,
        -by_body * rotation * skew(in_body) * so3_right_jacobian(correction.value.tail<3>());
    if (jacobians[0]) block<1, 6>(jacobians[0]) = (1 - correction.weight) * by_correction;
    if (jacobians[1]) block<1, 6>(jacobians[1]) = correction.weight * by_correction;
    if (jacobians[2])
      block<1, 3>(jacobians[2]) << axes_.col(0).dot(from_centre) / sigma_m_,
          axes_.col(1).dot(from_centre) / sigma_m_, -1 / sigma_m_;
    if (jacobians[3]) jacobians[3][0] = by_body.dot(rotation * in_body_.slope(parameters[3][0]));
    return true;
  }

 private:
  LocalMotion motion_;
  RaisedReturn in_body_;
  double sigma_m_;
  Vector3d centre_;
  Matrix3d axes_;
};

/// X in the body at the time of the motion: b = exp(phi)^T (pose^-1 X - rho).
class PointOnSurfaceCost final : public ceres::SizedCostFunction<1, 6, 6, 3> {
 public:
  PointOnSurfaceCost(const LocalMotion& motion, const SurfaceElement& surface,
                     const InverseDepthPoint& point)
      : motion_(motion), surface_(surface) {
    const Rigid3d& pose = motion.world_from_body;
    axes_ = pose.linear().transpose() * point.axes;
    anchor_ = pose.linear().transpose() * (point.anchor - pose.translation());
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const InterpolatedCorrection correction = interpolate(parameters[0], parameters[1], motion_, 0);
    const Map<const Vector3d> point(parameters[2]);
    const double w = point.z();
    if (!(w > 0)) return false;  // no step to infinity
    const Matrix3d unphi = so3_exp(correction.value.tail<3>()).transpose();
    const Vector3d direction = axes_ * Vector3d(point.x(), point.y(), 1);
    const Vector3d b = unphi * (anchor_ + direction / w - correction.value.head<3>());
    residuals[0] = surface_.normal.dot(b - surface_.in_body) / surface_.sigma_m;
    if (!jacobians) return true;
    const Eigen::RowVector3d by_b = surface_.normal.transpose() / surface_.sigma_m;
    Eigen::Matrix<double, 1, 6> by_correction;
    by_correction << -by_b * unphi, by_b * skew(b) * so3_right_jacobian(correction.value.tail<3>());
    if (jacobians[0]) block<1, 6>(jacobians[0]) = (1 - correction.weight) * by_correction;
    if (jacobians[1]) block<1, 6>(jacobians[1]) = correction.weight * by_correction;
    if (jacobians[2]) {
      const Eigen::RowVector3d by_position = by_b * unphi / w;
      block<1, 3>(jacobians[2]) << by_position * axes_.col(0), by_position * axes_.col(1),
          -by_position * direction / w;
    }
    return true;
  }

 private:
  LocalMotion motion_;
  SurfaceElement surface_;
  Matrix3d axes_;    // the point's axes in the initial body's axes
  Vector3d anchor_;  // likewise
};

class LinearPrior final : public ceres::CostFunction {
 public:
  LinearPrior(const Eigen::VectorXd& direction, double sigma, double expected)
      : weights_(direction / sigma), expected_(expected / sigma) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(static_cast<int>(direction.size()));
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    residuals[0] =
        weights_.dot(Map<const Eigen::VectorXd>(parameters[0], weights_.size())) - expected_;
    if (jacobians && jacobians[0]) Map<Eigen::VectorXd>(jacobians[0], weights_.size()) = weights_;
    return true;
  }

 private:
  Eigen::VectorXd weights_;
  double expected_;
};

class PosePrior final : public ceres::SizedCostFunction<6, 6> {
 public:
  explicit PosePrior(const Vector6d& sigmas) : weights_(sigmas.cwiseInverse()) {}
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    Map<Vector6d> residual(residuals);
    residual = weights_.cwiseProduct(Map<const Vector6d>(parameters[0]));
    if (jacobians && jacobians[0]) block<6, 6>(jacobians[0]) = weights_.asDiagonal();
    return true;
  }

 private:
  Vector6d weights_;
};

class Smoothness final : public ceres::SizedCostFunction<6, 6, 6> {
 public:
  explicit Smoothness(const Vector6d& sigmas) : weights_(sigmas.cwiseInverse()) {}
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    Map<Vector6d> residual(residuals);
    residual = weights_.cwiseProduct(Map<const Vector6d>(parameters[1]) -
                                     Map<const Vector6d>(parameters[0]));
    if (jacobians && jacobians[0]) block<6, 6>(jacobians[0]) = Vector6d(-weights_).asDiagonal();
    if (jacobians && jacobians[1]) block<6, 6>(jacobians[1]) = weights_.asDiagonal();
    return true;
  }

 private:
  Vector6d weights_;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> reprojection_cost(const RigModelCamera& camera,
                                                       const LocalMotion& motion,
                                                       const Eigen::Vector2d& pixel,
                                                       double sigma_px,
                                                       const InverseDepthPoint& point) {
  return std::make_unique<ReprojectionCost>(camera, motion, pixel, sigma_px, point);
}

std::unique_ptr<ceres::CostFunction> point_to_plane_cost(const LocalMotion& motion,
                                                         const RaisedReturn& in_body,
                                                         double sigma_m,
                                                         const PlaneParameters& plane) {
  return std::make_unique<PointToPlaneCost>(motion, in_body, sigma_m, plane);
}

std::unique_ptr<ceres::CostFunction> point_on_surface_cost(const LocalMotion& motion,
                                                           const SurfaceElement& surface,
                                                           const InverseDepthPoint& point) {
  return std::make_unique<PointOnSurfaceCost>(motion, surface, point);
}

std::unique_ptr<ceres::CostFunction> scalar_prior_cost(int size, int k, double sigma,
                                                       double expected) {
  return std::make_unique<LinearPrior>(Eigen::VectorXd::Unit(size, k), sigma, expected);
}
std::unique_ptr<ceres::CostFunction> direction_prior_cost(const Vector6d& direction, double sigma) {
  return std::make_unique<LinearPrior>(direction, sigma, 0);
}
std::unique_ptr<ceres::CostFunction> pose_prior_cost(const Vector6d& sigmas) {
  return std::make_unique<PosePrior>(sigmas);
}
std::unique_ptr<ceres::CostFunction> smoothness_cost(const Vector6d& sigmas) {
  return std::make_unique<Smoothness>(sigmas);
}

}  // namespace redrive
