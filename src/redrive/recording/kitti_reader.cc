// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/kitti_reader.h"

#include "redrive/base/files.h"

namespace redrive::kitti {

std::vector<LidarPoint> Reader::read_lidar(const FrameFile& file) const {
  return parse_scan(read_file(file.path), file.path, body_from_velodyne, scans.at(file.frame_id));
}

std::uint64_t Reader::lidar_point_count(const FrameFile& file) const {
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(file.path, error);
  return error || bytes % kScanRecordBytes != 0 ? 0 : bytes / kScanRecordBytes;
}

std::vector<Box> Reader::read_boxes(const FrameFile& file) const { return boxes.at(file.frame_id); }

CameraCalibration calibration_of(const RectifiedCamera& camera, ImageSize size,
                                 const std::string& name, const Rigid3d& rectified_from_body) {
  CameraCalibration calibration;
  calibration.name = name;
  calibration.model = "opencv_pinhole";
  calibration.parameters = {camera.fx, camera.fy, camera.cx, camera.cy, 0, 0, 0, 0, 0};
  calibration.width = size.width;
  calibration.height = size.height;
  calibration.body_from_sensor =
      (camera.camera_from_rectified * rectified_from_body).inverse(Eigen::Isometry);
  return calibration;
}

}  // namespace redrive::kitti
