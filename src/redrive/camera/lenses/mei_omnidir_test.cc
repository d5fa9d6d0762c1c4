// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>
#include <opencv2/ccalib/omnidir.hpp>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

TEST(Mei, AgreesWithOpenCvOmnidir) {
  int compared = 0;
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const Mei* mei = std::get_if<Mei>(&camera.model);
    if (!mei || mei->distortion.k3 != 0) continue;  // omnidir has no k3
    SCOPED_TRACE(example.name);
    std::vector<cv::Vec3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (int i = 0; i < 5000; ++i) {
      const double angle = 2.4 * (i + 0.5) / 5000,
                   turn = 2.399963229728653 * i;  // to 137 degrees from the axis
      const Eigen::Vector3d point =
          2.5 * Eigen::Vector3d(std::sin(angle) * std::cos(turn), std::sin(angle) * std::sin(turn),
                                std::cos(angle));
      if (const auto pixel = camera.project(point); pixel && pixel->norm() < 1e4) {
        points.emplace_back(point.x(), point.y(), point.z());
        ours.push_back(*pixel);
      }
    }
    ASSERT_GT(points.size(), 1000u);
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    const BrownConrady& lens = mei->distortion;
    std::vector<cv::Vec2d> theirs;
    cv::omnidir::projectPoints(points, theirs, cv::Vec3d(), cv::Vec3d(), k, mei->xi,
                               cv::Vec4d(lens.k1, lens.k2, lens.p1, lens.p2));
    for (std::size_t i = 0; i < points.size(); ++i)
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i][0], ours[i].y() - theirs[i][1]), 1e-6)
          << points[i];
    ++compared;
  }
  EXPECT_GE(compared, 3);
}

}  // namespace
}  // namespace redrive
