// SPDX-License-Identifier: Apache-2.0
// The aiMotive layout (Matuszka et al., arXiv:2211.09445): sensor/calibration/calibration.json,
// sensor/gnssins/egomotion2.json (or egomotion.json), sensor/camera/<CAM>/<CAM>_<7-digit id>.jpg,
// dynamic/box/3d_body, dynamic/raw-revolutions. Made recordings also have
// sensor/calibration/calibration_true.json and sensor/gnssins/egomotion2_true.json: the same files
// without errors.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/recording/recording.h"

namespace redrive::aimotive {

bool looks_like(const std::filesystem::path& root);
Recording open(const std::filesystem::path& root, PoseSource source);

/// Sensors of a calibration.json that are no cameras.
struct OtherSensors {
  std::vector<std::string> names;
  std::optional<Rigid3d> body_from_lidar;  ///< nothing unless exactly one sensor of type "lidar"
                                           ///< has an RT_body_from_sensor
};

/// Cameras of a calibration.json; what else is in it goes into `others`, which may be null. `file`
/// is for messages. Refuses (InputError): unknown model, wrong shapes, NaN, focal length <= 0, an
/// extrinsic that is no rotation or mirrors (det < 0), and one that is inverted: it disagrees with
/// RT_sensor_from_body or pos_meter, or the camera's y axis does not point down while that of the
/// inverse does.
std::vector<CameraCalibration> parse_calibration(std::string_view text,
                                                 const std::filesystem::path& file,
                                                 OtherSensors* others);

/// Poses of an egomotion file, keyed by id without leading zeros; RT_ECEF_body or ECEF_RT_body; by
/// id.
std::vector<FramePose> parse_egomotion(std::string_view text, const std::filesystem::path& file);

/// What POSES.json shares with the two files above. The cameras by name; none is no error here.
std::vector<CameraCalibration> cameras_from_json(const JsonField& sensors, OtherSensors* others);

/// RT_ECEF_body or ECEF_RT_body of an entry, at most 1e7 m from the origin; nothing if it has
/// neither.
std::optional<Rigid3d> ecef_from_body_in(const JsonField& entry);

}  // namespace redrive::aimotive
