// SPDX-License-Identifier: Apache-2.0
// A small valid drive of KITTI-360 with made numbers, for tests, which then break one value.
#pragma once

#include <string>

#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive::testing {

constexpr const char* kKitti360Drive = "2013_05_28_drive_0007_sync";

inline std::string kitti360_perspective() {
  return "calib_time: 17-Feb-2016 14:23:48\ncorner_dist: 0.1\n"
         "S_rect_00: 1408.0 376.0\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
         "P_rect_00: 552 0 682 0 0 552 238 0 0 0 1 0\n"
         "S_rect_01: 1408.0 376.0\nR_rect_01: 1 0 0 0 1 0 0 0 1\n"
         "P_rect_01: 552 0 682 -331.2 0 552 238 0 0 0 1 0\n";
}

inline std::string kitti360_fisheye() {
  return "%YAML:1.0\nmodel_type: MEI\ncamera_name: image_02\nimage_width: 1400\n"
         "image_height: 1400\nmirror_parameters:\n   xi: 2.2134047507854890e+00\n"
         "distortion_parameters:\n   k1: 1.6e-02\n   k2: 1.65\n   p1: 4e-04\n   p2: 5e-04\n"
         "projection_parameters:\n   gamma1: 1336.0\n   gamma2: 1335.5\n   u0: 716.9\n"
         "   v0: 705.8\n";
}

/// Camera 0 looks ahead, 1.5 m ahead of the IMU, 0.32 m to its right and 0.65 m above it; camera 2
/// looks to the left.
inline std::string kitti360_cam_to_pose() {
  return "image_00: 0 0 1 1.5 1 0 0 0.32 0 1 0 -0.65\n"
         "image_02: 1 0 0 0.7 0 0 -1 -0.15 0 1 0 -1.07\n";
}

/// The IMU at 1 m a frame along the world's x axis, 0.9 m above z = 0.
inline std::string kitti360_pose(int frame) {
  return std::to_string(frame) + " 1 0 0 " + std::to_string(frame) + " 0 -1 0 0 0 0 -1 0.9\n";
}

/// Frames 2, 3 and 4 of 6 with images of cameras 0 and 2, the latter 3 ms later, and scans that
/// look ahead 10 ms before the images.
inline void write_kitti360_drive(const TemporaryFolder& folder) {
  const std::filesystem::path drive = kKitti360Drive, images = "data_2d_raw" / drive,
                              scans = "data_3d_raw" / drive / "velodyne_points";
  folder.write("calibration/perspective.txt", kitti360_perspective());
  folder.write("calibration/image_02.yaml", kitti360_fisheye());
  folder.write("calibration/calib_cam_to_pose.txt", kitti360_cam_to_pose());
  folder.write("calibration/calib_cam_to_velo.txt", "0 0 1 0.8 -1 0 0 0 0 -1 0 -0.2\n");
  std::string poses;
  for (int f = 2; f <= 4; ++f) {
    const std::string name = "000000000" + std::to_string(f);
    folder.write(images / ("image_00/data_rect/" + name + ".png"), png_head(1408, 376, name));
    folder.write(images / ("image_02/data_rgb/" + name + ".png"), png_head(1400, 1400, name));
    folder.write(scans / ("data/" + name + ".bin"), kitti_scan({{10, 0, 0, 1}, {0, 10, 0, 0.5f}}));
    poses += kitti360_pose(f);
  }
  folder.write("data_poses" / drive / "poses.txt", poses);
  folder.write(images / "image_00/timestamps.txt", kitti_timestamps(6, 5));
  folder.write(images / "image_02/timestamps.txt", kitti_timestamps(6, 5.003));
  folder.write(scans / "timestamps.txt", kitti_timestamps(6, 4.99));
}

}  // namespace redrive::testing
