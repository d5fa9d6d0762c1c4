// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/workload.h"

#include <cmath>

namespace redrive::bench {

SyntheticDrive make_synthetic_drive() {
  constexpr int kWidth = 1280, kHeight = 704, kViews = 4;
  SyntheticDrive drive;
  Camera camera;
  camera.model = OpenCvPinhole{};
  camera.fx = camera.fy = 1000;
  camera.cx = (kWidth - 1) / 2.0;
  camera.cy = (kHeight - 1) / 2.0;
  camera.width = kWidth;
  camera.height = kHeight;
  // Body axes x forward, y left, z up; camera axes x right, y down, z forward.
  Rigid3d body_from_sensor = Rigid3d::Identity();
  body_from_sensor.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  drive.scene.rig.push_back({"SYNTHETIC", camera, camera, body_from_sensor});
  drive.scene.global_from_world = Rigid3d::Identity();
  drive.scene.unit_from_world = {{1, 0, 0}, 1.0f / 12};
  for (int i = 0; i < kViews; ++i) {
    drive.scene.add_frame({i, i * 100'000'000, Rigid3d(Eigen::Translation3d(0.5 * i, 0, 0))});
    drive.scene.views.push_back({0, i, "", false, {}});
    Image8 image{kWidth, kHeight, {}};
    image.rgb.reserve(3 * kWidth * kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        for (int k = 0; k < 3; ++k)
          image.rgb.push_back(
              static_cast<std::uint8_t>(127.5 + 127 * std::sin(0.02 * x + 0.03 * y * k + i)));
    drive.images.push_back(std::move(image));
  }
  return drive;
}

SyntheticDrive wide_angle(SyntheticDrive drive) {
  Camera& camera = drive.scene.rig[0].camera;
  camera.fx = camera.fy = 150;
  drive.scene.rig[0].recorded = camera;
  return drive;
}

void add_actors(int n, SyntheticDrive* drive) {
  constexpr int kLanes = 4;
  constexpr double kSpeed_m_per_s = 5;
  for (int i = 0; i < n; ++i) {
    MovingObject car{.id = i + 1, .type = "CAR", .size_m = {4, 2, 1.5}, .keys = {}};
    const double ahead_m = 3 * std::pow(100.0 / 3, (i / kLanes + 0.5) * kLanes / n);
    for (const Frame& frame : drive->scene.frames) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() =
          Eigen::Vector3d(ahead_m + kSpeed_m_per_s * 1e-9 * static_cast<double>(frame.t_ns),
                          4 * (i % kLanes) - 6, -0.75);
      car.keys.push_back({frame.t_ns, pose, {kSpeed_m_per_s, 0, 0}});
    }
    drive->scene.actors.push_back(car);
  }
}

}  // namespace redrive::bench
