// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/recording_reader.h"

#include "redrive/base/error.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/recording/formats/egomotion_json.h"
#include "redrive/recording/lidar/ply.h"

namespace redrive {
namespace {

constexpr const char *kEgomotionFile = "egomotion.json", *kCalibrationFile = "calibration.json";

}  // namespace

std::vector<LidarPoint> Recording::read_lidar(const FrameFile& file, std::size_t* left_out) const {
  std::vector<LidarPoint> points = reader->read_lidar(file, left_out);
  if (file.lidar >= lidars.size() || lidars[file.lidar].elevation_rad == 0) return points;
  const RecordedLidar& lidar = lidars[file.lidar];
  for (LidarPoint& point : points)
    point.in_body_m = RaisedReturn(lidar.body_from_lidar, point.in_body_m.cast<double>())
                          .at(lidar.elevation_rad)
                          .cast<float>();
  return points;
}

std::vector<FrameFile> Recording::scans_of(std::size_t lidar) const {
  std::vector<FrameFile> scans;
  for (const FrameFile& file : lidar_files)
    if (file.lidar == lidar) scans.push_back(file);
  return scans;
}

double first_elevation_rad(const Recording& recording) {
  return recording.lidars.empty() ? 0 : recording.lidars[0].elevation_rad;
}

std::vector<LidarPoint> RecordingReader::read_lidar(const FrameFile& file, std::size_t*) const {
  throw InputError(file.path, "", "", "LiDAR of a recording whose format has none");
}

std::uint64_t RecordingReader::lidar_point_count(const FrameFile&) const { return 0; }

std::vector<StaticPoint> RecordingReader::read_points(const Recording& recording) const {
  std::vector<StaticPoint> points;
  for (const Eigen::Vector3d& in_body : read_ply(recording.points_file))
    points.push_back({recording.frames.front().global_from_body * in_body, {}, false});
  return points;
}

std::vector<Box> RecordingReader::read_boxes(const FrameFile& file) const {
  throw InputError(file.path, "", "", "boxes of a recording whose format has none");
}

std::vector<std::filesystem::path> RecordingReader::pose_file_names() const {
  return {kEgomotionFile, kCalibrationFile};
}

PoseFiles RecordingReader::make_pose_files(const Recording& recording,
                                           const std::vector<FramePose>& frames,
                                           const std::vector<CameraCalibration>& cameras) const {
  nlohmann::json sensors = nlohmann::json::object();
  for (const CameraCalibration& camera : cameras)
    sensors[camera.name] = calibration_to_json(camera);
  update_lidar(first_elevation_rad(recording), &sensors);
  return {{kEgomotionFile, egomotion_to_json(frames).dump(1) + "\n"},
          {kCalibrationFile, sensors.dump(1) + "\n"}};
}

CalibratedPoses RecordingReader::parse_pose_files(const PoseFiles& files,
                                                  const std::filesystem::path& folder,
                                                  const DamagedList* damaged) const {
  const std::vector<std::filesystem::path> names = pose_file_names();
  CalibratedPoses poses;
  poses.frames_file = folder / names[0];
  poses.cameras_file = folder / names[1];
  poses.frames = parse_egomotion(files.at(names[0]), poses.frames_file, damaged);
  OtherSensors others;
  poses.cameras = parse_calibration(files.at(names[1]), poses.cameras_file, &others);
  poses.lidar_elevation_rad = others.lidar_elevation_rad;
  return poses;
}

std::shared_ptr<const RecordingReader> basic_reader() {
  static const auto reader = std::make_shared<const RecordingReader>();
  return reader;
}

}  // namespace redrive
