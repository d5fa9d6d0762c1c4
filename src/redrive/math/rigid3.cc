// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/rigid3.h"

#include <sstream>

namespace redrive {

namespace {

using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

}  // namespace

PlainPose plain(const Rigid3d& pose) {
  PlainPose out;
  Eigen::Map<RowMajor>(out.rotation) = pose.linear();
  Eigen::Map<Eigen::Vector4d>(out.quaternion) = Eigen::Quaterniond(pose.linear()).coeffs();
  Eigen::Map<Eigen::Vector3d>(out.translation) = pose.translation();
  return out;
}

Rigid3d rigid(const PlainPose& pose) {
  Rigid3d out = Rigid3d::Identity();
  out.linear() = Eigen::Map<const RowMajor>(pose.rotation);
  out.translation() = Eigen::Map<const Eigen::Vector3d>(pose.translation);
  return out;
}

Rigid3d interpolate(const Rigid3d& a, const Rigid3d& b, double fraction) {
  return rigid(interpolate(plain(a), plain(b), fraction));
}

std::string rigid_obstacle(const Eigen::Matrix4d& matrix) {
  constexpr double kOrthonormal = 1e-3, kLastRow = 1e-9;
  std::ostringstream why;
  if (!matrix.allFinite()) return "not finite";
  if ((matrix.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > kLastRow) {
    why << "last row is " << matrix.row(3) << ", not 0 0 0 1";
    return why.str();
  }
  const Eigen::Matrix3d rotation = matrix.topLeftCorner<3, 3>();
  const double deviation =
      (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(deviation <= kOrthonormal)) {  // so that inf - inf of huge entries is refused, too
    why << "not a rotation: rows not orthonormal by " << deviation;
  } else if (const double det = rotation.determinant(); det < 0) {
    why << "not a rotation: det = " << det << ", a reflection";
  }
  return why.str();
}

}  // namespace redrive
