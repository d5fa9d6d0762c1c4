// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/cloud_normals.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

class CloudNormals : public ::testing::Test {
 protected:
  void estimate(const Eigen::Vector3f& seen_from) {
    const std::vector<Eigen::Vector3f> from(points_.size(), seen_from);
    estimate_normals(from, pool_, points_);
  }
  std::vector<PlyPoint> points_;
  ThreadPool pool_{2};
};

TEST_F(CloudNormals, AreThoseOfThePlaneTurnedToWhereItWasSeenFrom) {
  const Eigen::Vector3f normal = Eigen::Vector3f(1, 2, 3).normalized(), u = normal.unitOrthogonal(),
                        v = normal.cross(u);
  for (int i = 0; i < 20; ++i)
    for (int j = 0; j < 20; ++j)
      points_.push_back({0.1f * (static_cast<float>(i) * u + 1.3f * static_cast<float>(j) * v),
                         Eigen::Vector3f::Zero(),
                         {}});
  for (const float side : {5.0f, -5.0f}) {
    estimate(side * normal);
    for (const PlyPoint& point : points_)
      EXPECT_LT((point.normal - (side > 0 ? 1.0f : -1.0f) * normal).norm(), 1e-3f);
  }
}

TEST_F(CloudNormals, AreZeroWithoutAPlane) {
  for (int i = 0; i < 5; ++i) points_.push_back({Eigen::Vector3f(i, 0, i % 2), {}, {}});
  estimate({0, 9, 0});
  for (const PlyPoint& point : points_) EXPECT_TRUE(point.normal.isZero()) << "too few";
  points_.clear();
  for (int i = 0; i < 50; ++i)
    points_.push_back({Eigen::Vector3f(static_cast<float>(i), 0, 1), {}, {}});
  estimate({0, 9, 0});
  for (const PlyPoint& point : points_) EXPECT_TRUE(point.normal.isZero()) << "a line";
}

}  // namespace
}  // namespace redrive
