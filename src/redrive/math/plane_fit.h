// SPDX-License-Identifier: Apache-2.0
// The plane through points by total least squares (Pearson 1901): their principal axes, of which
// the one with the least variance is the normal.
//   mean = sum p / n,  covariance = sum (p - mean) (p - mean)^T / n
// Sums are taken from the first point in double, so that places far from the origin lose no digits.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>

namespace redrive {

/// Mean of points, and the principal axes about it.
struct PlaneFit {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  /// Variance along each axis, ascending, at least 0, in the square of the points' unit.
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< unit columns, in the variances' order

  Eigen::Vector3d normal() const { return axes.col(0); }
  /// RMS extent along each axis; the first is the thickness: the RMS distance from the plane.
  Eigen::Vector3d extent() const { return variance.cwiseSqrt(); }
  double thickness() const { return extent()[0]; }
};

/// Sums over points, to which any number may be added before the plane is asked for.
class PlaneSums {
 public:
  template <class Point>
  void add(const Eigen::MatrixBase<Point>& point) {
    const Eigen::Vector3d p = point.template cast<double>();
    if (n_ == 0) first_ = p;
    ++n_;
    sum_ += p - first_;
    squares_ += (p - first_) * (p - first_).transpose();
  }

  int n() const { return n_; }

  /// Fits the plane; n() > 0. Points on a line determine no normal: the second variance tells.
  PlaneFit fit() const {
    const Eigen::Vector3d from_first = sum_ / n_;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(squares_ / n_ -
                                                              from_first * from_first.transpose());
    return {first_ + from_first, axes.eigenvalues().cwiseMax(0), axes.eigenvectors()};
  }

 private:
  int n_ = 0;
  Eigen::Vector3d first_ = Eigen::Vector3d::Zero(), sum_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares_ = Eigen::Matrix3d::Zero();
};

/// Fits the plane to position(i) for each i of `indices`, which must not be empty.
template <class Indices, class Position>
PlaneFit fit_plane(const Indices& indices, const Position& position) {
  PlaneSums sums;
  for (const auto i : indices) sums.add(position(i));
  return sums.fit();
}

}  // namespace redrive
