// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_pinhole.h"

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

TEST(OpenCvPinhole, AgreesWithOpenCv) {
  for (const ExampleCamera& example : example_cameras()) {
    if (!std::holds_alternative<OpenCvPinhole>(example.camera.model)) continue;
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    const BrownConrady& lens = std::get<OpenCvPinhole>(camera.model).distortion;
    std::vector<cv::Point3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (const Eigen::Vector3d& direction : directions(5000))
      if (const auto pixel = camera.project(direction * 4); pixel && pixel->norm() < 1e4) {
        points.emplace_back(4 * direction.x(), 4 * direction.y(), 4 * direction.z());
        ours.push_back(*pixel);
      }
    ASSERT_GT(points.size(), 200u);
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    std::vector<cv::Point2d> theirs;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k,
                      cv::Vec<double, 5>(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3), theirs);
    for (std::size_t i = 0; i < points.size(); ++i)
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y), 1e-6)
          << points[i];
  }
}

}  // namespace
}  // namespace redrive
