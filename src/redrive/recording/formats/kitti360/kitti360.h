// SPDX-License-Identifier: Apache-2.0
// KITTI-360 (Liao, Xie, Geiger: "KITTI-360: A Novel Dataset and Benchmarks for Urban Scene
// Understanding in 2D and 3D", PAMI 2022): data_2d_raw/<drive> with image_00 and image_01
// (data_rect) and the fisheyes image_02 and image_03 (data_rgb), data_3d_raw/<drive>,
// data_poses/<drive>, data_3d_bboxes/train/<drive>.xml and one calibration for all drives.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/recording/formats/kitti/kitti_reader.h"

namespace redrive::kitti360 {

/// A folder of one drive below data_2d_raw, data_3d_raw or data_poses, the data set's root, or an
/// excerpt that has images, scans, poses and calibration of a drive in one folder.
bool looks_like(const std::filesystem::path& root);
/// InputError if the root holds several drives.
Recording open(const std::filesystem::path& root, PoseSource source);

/// Poses belong to the GPS and IMU, which are mounted as in KITTI (Fig. 3 of Geiger et al., IJRR
/// 2013): 0.05 m behind the rear axle and 0.32 m to the left of the middle, here with axes x
/// forward, y right, z down and 0.9 m above the road. calib_cam_to_velo.txt places the Velodyne
/// 0.84 m above the IMU, 1.73 m above the road.
Rigid3d imu_from_body();

/// Beginning and end of the revolution of the Velodyne that looks ahead at t_ns.
kitti::ScanTime scan_at(std::int64_t t_ns, std::int64_t revolution_ns);
/// Median of the times between neighbouring lines, 0.1 s if there are none. InputError outside 0.05
/// to 0.5 s.
std::int64_t revolution_ns(const kitti::Timestamps& times);

/// The locations of a drive's files, from the data set's root.
struct Layout {
  std::filesystem::path root;
  std::string drive;

  std::filesystem::path camera(const std::string& name) const;  ///< with its timestamps.txt
  std::filesystem::path images(const std::string& name) const;
  std::filesystem::path velodyne() const;
  std::filesystem::path poses() const;
  std::filesystem::path calibration() const;
  std::filesystem::path boxes(const char* part = "train") const;
};

}  // namespace redrive::kitti360
