// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/rigid_json.h"

#include <Eigen/SVD>

namespace redrive {

Rigid3d rigid_from_json(const JsonField& field) {
  const Eigen::Matrix4d matrix = field.matrix4();
  if (const std::string why = rigid_obstacle(matrix); !why.empty()) field.fail(why);
  // Nearest rotation in the Frobenius norm (Schoenemann 1966): R = U V^T; det > 0 is checked above.
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix.topLeftCorner<3, 3>(),
                                              Eigen::ComputeFullU | Eigen::ComputeFullV);
  Rigid3d transform = Rigid3d::Identity();
  transform.linear() = svd.matrixU() * svd.matrixV().transpose();
  transform.translation() = matrix.topRightCorner<3, 1>();
  return transform;
}

nlohmann::json rigid_to_json(const Rigid3d& transform) {
  nlohmann::json rows = nlohmann::json::array();
  for (int r = 0; r < 4; ++r) {
    rows.push_back(nlohmann::json::array());
    for (int c = 0; c < 4; ++c)
      rows.back().push_back(r < 3 ? transform.matrix()(r, c) : c == 3 ? 1.0 : 0.0);
  }
  return rows;
}

}  // namespace redrive
