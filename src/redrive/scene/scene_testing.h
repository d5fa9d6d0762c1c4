// SPDX-License-Identifier: Apache-2.0
// For tests: a small drive with image files in a temporary folder.
#pragma once

#include <cmath>
#include <string>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// The colour of pixel (x, y) in camera `camera` (0 FISHEYE, 1 FRONT) at frame `frame`; identifies
/// its origin.
inline std::array<std::uint8_t, 3> test_colour(int camera, int frame, int x, int y) {
  return {static_cast<std::uint8_t>(5 * x), static_cast<std::uint8_t>(7 * y),
          static_cast<std::uint8_t>(128 * camera + 10 * frame)};
}

/// FISHEYE (mei, 20 x 14, looking left) and FRONT (barrel pinhole, 24 x 16) at frames 10, 11, ...
/// with PNG images. The body starts in Budapest, drives 1 m per frame along its x axis and turns
/// left by 0.1 rad per frame.
inline Recording make_test_recording(const std::filesystem::path& folder, int frames = 6) {
  Recording recording;
  recording.root = folder;
  recording.format = "test";
  RecordedCamera fisheye, front;
  fisheye.calibration = {"FISHEYE", "mei", {9, 9, 9.5, 6.5, 0.03, -0.08, 0, 0, 0, 1.02},
                         20,        14,    Rigid3d::Identity()};
  front.calibration = {
      "FRONT", "opencv_pinhole",   {22, 20, 11.5, 7.5, -0.3, 0.08, 0.002, 0.0006, 0}, 24,
      16,      Rigid3d::Identity()};
  // Columns: the camera's x, y, z axes in body axes.
  fisheye.calibration.body_from_sensor.linear() << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  fisheye.calibration.body_from_sensor.translation() = Eigen::Vector3d(1, 0.6, 1.4);
  front.calibration.body_from_sensor.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  front.calibration.body_from_sensor.translation() = Eigen::Vector3d(2, 0.1, 1.2);
  recording.cameras = {fisheye, front};

  Rigid3d global_from_body = Rigid3d::Identity();
  global_from_body.linear() =
      (Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized())).toRotationMatrix();
  global_from_body.translation() = Eigen::Vector3d(4081775.25, 1405467.5, 4679608.75);
  for (int n = 0; n < frames; ++n) {
    recording.frames.push_back({10 + n, 1000000000 + n * 66666667ll, global_from_body});
    global_from_body.translate(Eigen::Vector3d(1, 0, 0));
    global_from_body.rotate(Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()));
    for (int c = 0; c < 2; ++c) {
      const CameraCalibration& calibration = recording.cameras[c].calibration;
      Image8 image{calibration.width, calibration.height, {}};
      for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x)
          for (const std::uint8_t value : test_colour(c, n, x, y)) image.rgb.push_back(value);
      const auto path = folder / (calibration.name + "_" + std::to_string(10 + n) + ".png");
      write_image(path, image);
      recording.cameras[c].images.push_back({{10 + n, path}});
    }
  }
  return recording;
}

}  // namespace redrive
