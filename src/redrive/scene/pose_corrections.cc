// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/pose_corrections.h"

#include "redrive/math/so3.h"
#include "redrive/scene/scene.h"

namespace redrive {

PoseCorrections::PoseCorrections(const Scene& scene)
    : frames(static_cast<int>(scene.frames.size())),
      cameras(static_cast<int>(scene.rig.size())),
      values(size()) {}

Rigid3d rigid_from_vector(const float* six) {
  return rigid_from_vector(
      Vector6d(Eigen::Map<const Eigen::Matrix<float, 6, 1>>(six).cast<double>()));
}

std::array<float, 6> interpolate_vector6(const float* a, const float* b, double part) {
  std::array<float, 6> six;
  for (int k = 0; k < 6; ++k)
    six[k] = static_cast<float>(part == 0 ? a[k] : a[k] + part * (b[k] - a[k]));
  return six;
}

}  // namespace redrive
