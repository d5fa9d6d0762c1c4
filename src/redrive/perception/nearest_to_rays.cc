// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/nearest_to_rays.h"

#include <Eigen/Eigenvalues>

namespace redrive {

NearestToRays nearest_to_rays(std::span<const WorldRay> rays) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const WorldRay& ray : rays) {
    const Eigen::Matrix3d across =
        Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    normal += across;
    right += across * (ray.origin - rays[0].origin);
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(normal);
  const Eigen::Vector3d along = solver.eigenvectors().transpose() * right;
  return {solver.eigenvectors() * along.cwiseQuotient(solver.eigenvalues()),
          solver.eigenvalues()[0]};
}

}  // namespace redrive
