// SPDX-License-Identifier: Apache-2.0
// Rigid transforms as row-major 4x4 matrices, and vectors, in JSON.
#pragma once

#include "redrive/base/json_field.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// InputError if the matrix is no rigid transform (rigid_obstacle); its rotation is replaced by the
/// nearest orthonormal one.
Rigid3d rigid_from_json(const JsonField& field);

nlohmann::json rigid_to_json(const Rigid3d& transform);
inline nlohmann::json vector_to_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

/// Whether a quaternion is a rotation once it is normalised.
inline bool is_rotation(const Eigen::Quaterniond& quaternion) {
  constexpr double kLeastLength = 1e-6, kMostLength = 1e6;
  const double length = quaternion.norm();
  return length >= kLeastLength && length <= kMostLength;
}

}  // namespace redrive
