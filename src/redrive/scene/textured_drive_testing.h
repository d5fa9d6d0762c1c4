// SPDX-License-Identifier: Apache-2.0
// For tests: a drive down a street of textured planes, ray-cast, so that the position of each
// pixel's point in any other image has a closed form.
#pragma once

#include <cmath>
#include <limits>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/rng.h"
#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

/// Returns the first intersection of a ray from within the street: ground z = 0, walls y = 6 and y
/// = -5, and one across at x = 40.
inline Eigen::Vector3d hit_street(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  double nearest = std::numeric_limits<double>::infinity();
  const auto plane = [&](int axis, double at) {
    const double distance = (at - origin[axis]) / direction[axis];
    if (distance > 0) nearest = std::min(nearest, distance);
  };
  plane(2, 0);
  plane(1, 6);
  plane(1, -5);
  plane(0, 40);
  return origin + std::min(nearest, 200.0) * direction;
}

/// Smooth noise, 0..1, in cells of 0.6 m, 0.3 m and 0.15 m; octaves finer than a pixel average out.
inline double street_texture(const Eigen::Vector3d& point) {
  double value = 0;
  for (const double cell_m : {0.6, 0.3, 0.15}) {
    const Eigen::Vector3d scaled = point / cell_m + Eigen::Vector3d(0.37, 0.19, 0.53);
    const Eigen::Vector3d low = scaled.array().floor(), part = scaled - low;
    for (int corner = 0; corner < 8; ++corner) {
      std::uint64_t key = kStreamTest;
      double weight = 1;
      for (int d = 0; d < 3; ++d) {
        const int bit = corner >> d & 1;
        key = random_key(key, static_cast<std::uint64_t>(static_cast<std::int64_t>(low[d]) + bit));
        const double t = bit ? part[d] : 1 - part[d];
        weight *= t * t * (3 - 2 * t);
      }
      value += weight * random_unit(key, 0) / 3;
    }
  }
  return value;
}

/// Draws the street as `camera` sees it, each row with its own pose; grey without texture.
inline Image8 draw_street(const Camera& camera, const ShutterPoses& world_from_camera,
                          bool textured = true) {
  Image8 image{camera.width, camera.height, {}};
  for (int y = 0; y < camera.height; ++y) {
    const Rigid3d pose = world_from_camera.at_pixel(0, y, camera.width, camera.height);
    for (int x = 0; x < camera.width; ++x) {
      double value = textured ? 0 : 0.5;
      for (int s = 0; s < 4 && textured; ++s) {  // the pixel's area
        const auto ray =
            camera.unproject(Eigen::Vector2d(x + (s % 2) * 0.5 - 0.25, y + (s / 2) * 0.5 - 0.25));
        if (ray) value += street_texture(hit_street(pose.translation(), pose.linear() * *ray)) / 4;
      }
      image.rgb.insert(image.rgb.end(), 3, static_cast<std::uint8_t>(std::lround(255 * value)));
    }
  }
  return image;
}

/// The pose of `camera` at the time of its image of `frame`. `world_from_global`: usually the
/// inverse of the first pose.
inline Rigid3d world_from_camera_at(const Recording& recording, const Rigid3d& world_from_global,
                                    int camera, int frame) {
  const CameraCalibration& calibration = recording.cameras[camera].calibration;
  return world_from_global *
         pose_at(recording.frames, recording.frames[frame].t_ns + calibration.time_offset_ns) *
         calibration.body_from_sensor;
}

/// FISHEYE (mei) half left and FRONT (barrel pinhole), 200 x 140 both, in a vehicle that drives 0.4
/// m a frame and turns a little; frames 0.1 s apart. FISHEYE is exposed 20 ms late. Its world is
/// the street's.
inline Recording make_test_drive(const std::filesystem::path& folder, int frames,
                                 bool textured = true) {
  Recording recording;
  recording.root = folder;
  recording.format = "test";
  RecordedCamera fisheye, front;
  fisheye.calibration = {"FISHEYE", "mei", {90, 88, 99.5, 69.5, 0.03, -0.08, 0, 0, 0, 1.02},
                         200,       140,   Rigid3d::Identity(),
                         20'000'000};
  front.calibration = {
      "FRONT", "opencv_pinhole",   {130, 128, 99.5, 69.5, -0.2, 0.03, 0.002, 0.0006, 0}, 200,
      140,     Rigid3d::Identity()};
  Eigen::Matrix3d ahead;  // columns: the camera's x, y, z axes in body axes
  ahead << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const Eigen::AngleAxisd left(0.9, Eigen::Vector3d::UnitZ());
  fisheye.calibration.body_from_sensor = Eigen::Translation3d(1, 0.6, 1.4) * Rigid3d(left * ahead);
  front.calibration.body_from_sensor = Eigen::Translation3d(1.6, 0.1, 1.2) * Rigid3d(ahead);
  recording.cameras = {fisheye, front};
  for (int n = 0; n < frames; ++n)
    recording.frames.push_back(
        {n, 1'000'000'000 + n * 100'000'000ll,
         Eigen::Translation3d(0.4 * n, 0.03 * n, 0) *
             Rigid3d(Eigen::AngleAxisd(0.01 * n, Eigen::Vector3d::UnitZ()))});
  for (int c = 0; c < 2; ++c)
    for (int n = 0; n < frames; ++n) {
      RecordedCamera& recorded = recording.cameras[c];
      const Camera camera = make_camera(recorded.calibration);
      const Rigid3d pose = world_from_camera_at(recording, Rigid3d::Identity(), c, n);
      const Image8 image = draw_street(camera, pose, textured);
      const auto path = folder / (recorded.calibration.name + "_" + std::to_string(n) + ".png");
      write_image(path, image);
      recorded.images.push_back({{n, path}});
    }
  return recording;
}

}  // namespace redrive
