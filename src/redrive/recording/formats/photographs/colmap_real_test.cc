// SPDX-License-Identifier: Apache-2.0
// A model that COLMAP made of photographs; skipped where it is missing.
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include <gtest/gtest.h>

#include "redrive/camera/camera.h"
#include "redrive/recording/core/recording.h"

namespace redrive {
namespace {

// COLMAP's own model_analyzer says 0.355 px. Pixel centres that are half a pixel off double it.
TEST(RealColmap, PointsAreProjectedToTheirFeatures) {
  const std::filesystem::path root = REDRIVE_SHARED "/data/lund_door";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  const Recording recording = open_recording(root);
  ASSERT_EQ(recording.frames.size(), 12u);
  const CameraCalibration& calibration = recording.cameras.at(0).calibration;
  const Camera camera = make_camera(calibration);

  std::string line;
  std::map<long, Eigen::Vector3d> points;
  for (std::ifstream file(root / "sparse/0/points3D.txt"); std::getline(file, line);) {
    std::istringstream words(line);
    long id = 0;
    Eigen::Vector3d p;
    if (words >> id >> p.x() >> p.y() >> p.z()) points[id] = p;
  }
  double sum = 0;
  int count = 0, frame = -1;
  std::ifstream file(root / "sparse/0/images.txt");
  while (std::getline(file, line)) {
    if (line.starts_with("#")) continue;
    const Rigid3d camera_from_global =
        (recording.frames.at(++frame).global_from_body * calibration.body_from_sensor)
            .inverse(Eigen::Isometry);
    std::getline(file, line);
    std::istringstream words(line);
    long id = 0;
    for (Eigen::Vector2d feature; words >> feature.x() >> feature.y() >> id;) {
      const auto point = points.find(id);
      if (point == points.end()) continue;
      const auto pixel = camera.project(camera_from_global * point->second);
      ASSERT_TRUE(pixel);
      sum += (*pixel + Eigen::Vector2d(0.5, 0.5) - feature).norm();
      ++count;
    }
  }
  EXPECT_GT(count, 70000);
  EXPECT_NEAR(sum / count, 0.355, 0.01);
}

}  // namespace
}  // namespace redrive
