// SPDX-License-Identifier: Apache-2.0
// The records of one scene in the tables of nuScenes (docs/schema_nuscenes.md of
// nutonomy/nuscenes-devkit): scene, sample, sample_data, calibrated_sensor, sensor, ego_pose,
// sample_annotation, instance and category. Tables of all scenes together have gigabytes: records
// of other scenes are not parsed.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/nuscenes/token_tables.h"

namespace redrive::nuscenes {

/// A sensor as calibrated on the car of the scene; its name is its channel, "CAM_FRONT".
/// body_from_sensor is set for any sensor, the rest only for cameras: pinholes, since images are
/// undistorted.
struct Sensor {
  std::string modality;  ///< "camera", "lidar" or "radar"
  CameraCalibration calibration;
};

/// A file of a sensor.
struct SensorFile {
  std::size_t sensor = 0;  ///< index into SceneTables::sensors
  std::size_t sample = 0;  ///< index into SceneTables::sample_times_ns
  std::filesystem::path path;
  std::int64_t t_ns = 0;
  bool key_frame = false;  ///< belongs to its sample, not between two samples
};

/// The box of an object at a sample.
struct Annotation {
  std::size_t sample = 0, object = 0;
  Rigid3d global_from_box;  ///< axes and origin of the box as in Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

struct SceneTables {
  std::string name;  ///< "scene-0061"
  std::vector<std::int64_t> sample_times_ns;
  std::vector<Sensor> sensors;    ///< sorted by channel; sensors with files
  std::vector<SensorFile> files;  ///< files of cameras and LIDAR_TOP, in order of time
  /// the body's at the times of `files`, in order of time; ids count them
  std::vector<FramePose> poses;
  std::vector<Annotation> annotations;
  std::vector<std::string> categories;  ///< categories of objects: "vehicle.car"
  std::vector<DamagedRecord> damaged;   ///< impossible poses, and times of files
};

/// Reads the scene of that name or token, or the only one if `scene` is empty, from the tables in
/// `folder`, whose parent holds the files. InputError: a table that is missing or no array of
/// records; no such scene (the message names the existing ones); tokens that no record has; fields
/// that are missing or of another type; numbers that are not finite; rotations of no length;
/// positions further than 1e7 m; sizes outside 0.01..100 m; file names that leave the parent
/// folder; a sensor with two calibrations. An impossible pose of the body or time of a file costs
/// only itself. Without `boxes`, sample_annotation, instance and category are not read.
SceneTables read_scene(const std::filesystem::path& folder, const std::string& scene,
                       const ReadTable& read = scan_file, bool boxes = true);

}  // namespace redrive::nuscenes
