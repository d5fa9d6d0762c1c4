// SPDX-License-Identifier: Apache-2.0
// Calibrations as JSON, keyed by sensor: calibration.json of drives and "calibration" of
// POSES.json.
//   {"CAM": {"sensor_type": "camera", "model", "image_resolution_px": [w, h],
//    "focal_length_px": [fx, fy], "principal_point_px": [cx, cy], "distortion_coeffs": [...],
//    other parameters of the model by name ("xi"), "RT_body_from_sensor": 4x4,
//    "RT_sensor_from_body", "pos_meter", "time_offset_s", "readout_s"}}
// The last four are optional; the first two of them are checked against RT_body_from_sensor. A
// LiDAR ("sensor_type": "lidar") may have "elevation_offset_deg" (RecordedLidar::elevation_rad).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/camera/calibration.h"

namespace redrive {

/// Sensors of a calibration that are no cameras.
struct OtherSensors {
  std::vector<std::string> names;
  std::optional<Rigid3d> body_from_lidar;  ///< set if exactly one sensor of type "lidar" has an
                                           ///< RT_body_from_sensor
  double lidar_elevation_rad = 0;          ///< RecordedLidar::elevation_rad of the first
};

/// Returns cameras sorted by name; other sensors go into `others`, which may be null. InputError:
/// unknown model, wrong shapes, NaN, focal length <= 0, extrinsics that are no rotation or mirror
/// (det < 0), and inverted extrinsics: they disagree with RT_sensor_from_body or pos_meter, or the
/// camera's y axis does not point down while the inverse's does.
std::vector<CameraCalibration> cameras_from_json(const JsonField& sensors, OtherSensors* others);

/// Cameras of a calibration.json, at least one. `file` is for messages.
std::vector<CameraCalibration> parse_calibration(std::string_view text,
                                                 const std::filesystem::path& file,
                                                 OtherSensors* others);

/// The entry of a camera.
nlohmann::json calibration_to_json(const CameraCalibration& camera);

/// Writes extrinsics, focal length, principal point, time offset and readout into an entry. Other
/// fields stay, but for angles that the new extrinsics contradict (yaw_pitch_roll_deg).
void update_calibration(const CameraCalibration& camera, nlohmann::json* entry);

/// Writes the first LiDAR's elevation_rad into the entry of the LiDAR, which is made where there is
/// none and the elevation is not 0.
void update_lidar(double elevation_rad, nlohmann::json* sensors);

}  // namespace redrive
