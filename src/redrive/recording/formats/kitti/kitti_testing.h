// SPDX-License-Identifier: Apache-2.0
// Small valid excerpts of KITTI with made numbers, for tests, which then break one value.
#pragma once

#include <array>
#include <cstdio>
#include <cstring>
#include <initializer_list>
#include <string>

#include "redrive/recording/core/recording_testing.h"

namespace redrive::testing {

/// Cameras 0 and 2, level, looking along the x axis of the Velodyne, 0.25 m ahead of it; camera 2
/// is 0.06 m to the left of camera 0, 721 pixels of focal length.
inline std::string kitti_cam_to_cam() {
  return "calib_time: 09-Jan-2012 13:57:47\n"
         "corner_dist: 9.95e-02\n"
         "S_rect_00: 1242 375\n"
         "R_rect_00: 1 0 0 0 1 0 0 0 1\n"
         "P_rect_00: 720 0 600 0 0 720 180 0 0 0 1 0\n"
         "S_rect_02: 1.242e+03 3.75e+02\n"
         "P_rect_02: 720 0 600 43.2 0 720 180 0 0 0 1 0\n";
}
inline std::string kitti_velo_to_cam() {
  return "calib_time: 15-Mar-2012 11:37:16\n"
         "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.25\ndelta_f: 0 0\n";
}
inline std::string kitti_imu_to_velo() { return "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n"; }

/// A packet at 49 degrees north, 8 degrees east, `north_m` further north, facing north.
inline std::string kitti_oxts(double north_m) {
  char packet[256];
  // 1e-5 degrees are 1.112 m: the meridian's radius of curvature there is 6.372e6 m.
  std::snprintf(packet, sizeof packet, "%.15f 8 110 0 0 1.5707963267948966",
                49 + north_m / 6.372e6 * 180 / 3.14159265358979);
  std::string text = packet;
  for (int i = 6; i < 30; ++i) text += " 0.5";
  return text + "\n";
}

/// `times` of the first `frames` frames, 0.1 s apart from `first_s` (below 50) on.
inline std::string kitti_timestamps(int frames, double first_s) {
  std::string text;
  for (int f = 0; f < frames; ++f) {
    char line[64];
    std::snprintf(line, sizeof line, "2011-09-26 13:10:%012.9f\n", first_s + 0.1 * f);
    text += line;
  }
  return text;
}

/// Records of a scan: x, y, z, reflectance.
inline std::string kitti_scan(const std::vector<std::array<float, 4>>& points) {
  std::string bytes;
  for (const auto& point : points)
    bytes.append(reinterpret_cast<const char*>(point.data()), sizeof point);
  return bytes;
}

/// The first bytes of a PNG of that size, and what tells it from other images.
inline std::string png_head(int width, int height, const std::string& pixels = "") {
  std::string head("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16);
  for (const int side : {width, height})
    for (const int shift : {24, 16, 8, 0}) head += static_cast<char>(side >> shift & 0xff);
  return head + std::string("\x08\x02\0\0\0", 5) + pixels;  // 8 bits of each of three colours
}

/// A line of label_02, straight ahead of camera 0, facing away from it.
inline std::string kitti_label(int frame, int track, const std::string& type, double z_m) {
  return std::to_string(frame) + " " + std::to_string(track) + " " + type +
         " 0 0 -1.57 500 100 600 200 1.5 1.8 4.2 1 1.6 " + std::to_string(z_m) +
         " -1.5707963267948966\n";
}

constexpr const char* kKittiDrive = "2011_09_26/2011_09_26_drive_0001_sync";

/// A drive of frames 2, 3 and 4 of 6 at 10 m/s to the north: images of camera 2 and the scans'
/// middles 10 ms before the packets, with camera 0 2 ms after camera 2.
inline void write_kitti_drive(const TemporaryFolder& folder) {
  const std::filesystem::path day = "2011_09_26", drive = kKittiDrive;
  folder.write(day / "calib_cam_to_cam.txt", kitti_cam_to_cam());
  folder.write(day / "calib_velo_to_cam.txt", kitti_velo_to_cam());
  folder.write(day / "calib_imu_to_velo.txt", kitti_imu_to_velo());
  folder.write(drive / "oxts/timestamps.txt", kitti_timestamps(6, 5.01));
  folder.write(drive / "image_00/timestamps.txt", kitti_timestamps(6, 5.002));
  folder.write(drive / "image_02/timestamps.txt", kitti_timestamps(6, 5));
  folder.write(drive / "velodyne_points/timestamps_start.txt", kitti_timestamps(6, 4.95));
  folder.write(drive / "velodyne_points/timestamps_end.txt", kitti_timestamps(6, 5.05));
  for (int f = 2; f <= 4; ++f) {
    const std::string name = "000000000" + std::to_string(f);
    folder.write(drive / ("oxts/data/" + name + ".txt"), kitti_oxts(f));
    for (const std::string camera : {"image_00", "image_02"})
      folder.write(drive / camera / ("data/" + name + ".png"), png_head(1242, 375, name));
    folder.write(drive / ("velodyne_points/data/" + name + ".bin"),
                 kitti_scan({{10, 0, 0, 1}, {0, 10, 0, 0.5f}}));
  }
}

/// Sequence 04 of three frames at 10 m/s along the camera's axis.
inline void write_kitti_sequence(const TemporaryFolder& folder) {
  const std::filesystem::path sequence = "sequences/04";
  folder.write(sequence / "calib.txt",
               "P0: 720 0 600 0 0 720 180 0 0 0 1 0\n"
               "P2: 720 0 600 43.2 0 720 180 0 0 0 1 0\n"
               "Tr: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.25\n");
  folder.write(sequence / "times.txt", "0.000000e+00\n1.0e-01\n2.0e-01\n");
  folder.write("poses/04.txt",
               "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n1 0 0 0 0 1 0 0 0 0 1 2\n");
  for (const std::string name : {"000000", "000001", "000002"}) {
    folder.write(sequence / ("image_2/" + name + ".png"), png_head(1226, 370, name));
    folder.write(sequence / ("velodyne/" + name + ".bin"), kitti_scan({{10, 0, 0, 0.25f}}));
  }
}

}  // namespace redrive::testing
