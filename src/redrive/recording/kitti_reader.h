// SPDX-License-Identifier: Apache-2.0
// What raw drives and sequences of the odometry benchmark of KITTI have in common.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "redrive/recording/kitti_calibration.h"
#include "redrive/recording/kitti_scan.h"
#include "redrive/recording/recording_reader.h"

namespace redrive::kitti {

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file) const override;
  std::uint64_t lidar_point_count(const FrameFile& file) const override;
  std::vector<Box> read_boxes(const FrameFile& file) const override;

  Rigid3d body_from_velodyne = Rigid3d::Identity();
  std::map<std::int64_t, ScanTime> scans;          ///< by frame: those of Recording::lidar_files
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< by frame: those of Recording::box_files
};

/// The calibration of a rectified camera. `size`: of its images.
CameraCalibration calibration_of(const RectifiedCamera& camera, ImageSize size,
                                 const std::string& name, const Rigid3d& rectified_from_body);

}  // namespace redrive::kitti
