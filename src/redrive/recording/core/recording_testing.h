// SPDX-License-Identifier: Apache-2.0
// Small valid recordings for tests, which then break one field.
#pragma once

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive::testing {

/// Runs `action` and returns the message of the InputError that it must throw.
template <class F>
std::string input_error(F&& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  ADD_FAILURE() << "no InputError";
  return "";
}

/// Returns a camera that looks forward, 2 m ahead of and 1.5 m above the body's origin, with exact
/// extrinsics.
inline nlohmann::json front_camera() {
  return {{"sensor_type", "camera"},
          {"model", "opencv_pinhole"},
          {"RT_body_from_sensor", {{0, 0, 1, 2}, {-1, 0, 0, 0.5}, {0, -1, 0, 1.5}, {0, 0, 0, 1}}},
          {"RT_sensor_from_body", {{0, -1, 0, 0.5}, {0, 0, -1, 1.5}, {1, 0, 0, -2}, {0, 0, 0, 1}}},
          {"pos_meter", {2, 0.5, 1.5}},
          {"focal_length_px", {1171.5, 1001.25}},
          {"principal_point_px", {640, 352.5}},
          {"distortion_coeffs", {-0.3, 0.08, 0.002, 0.0006, 0}},
          {"image_resolution_px", {1280, 704}}};
}

inline nlohmann::json fisheye_camera() {
  nlohmann::json camera = front_camera();
  camera["model"] = "mei";
  camera["xi"] = 1.02;
  return camera;
}

inline nlohmann::json calibration() {
  return {{"F_CAM", front_camera()},
          {"L_FISH", fisheye_camera()},
          {"Imu0", {{"sensor_type", "imu_ins"}, {"pos_meter", {0, 0, 0}}}},
          {"M_LIDAR", {{"sensor_type", "lidar"}, {"rpm", "nan"}}}};
}

/// Returns a pose without rotation, at x metres along the first axis of ECEF.
inline nlohmann::json pose_at(double x, double t_s) {
  return {{"RT_ECEF_body", {{1, 0, 0, 4e6 + x}, {0, 1, 0, 1.4e6}, {0, 0, 1, 4.6e6}, {0, 0, 0, 1}}},
          {"time_host", t_s}};
}

/// Frames 9, 10, 11 (in text order 10 and 11 come first), 0.1 s and 2 m apart.
inline nlohmann::json egomotion() {
  return {{"9", pose_at(0, 50.0)}, {"10", pose_at(2, 50.1)}, {"11", pose_at(4, 50.2)}};
}

/// Writes a recording of two cameras and three frames with empty image files.
inline void write_recording(const TemporaryFolder& folder) {
  folder.write("sensor/calibration/calibration.json", calibration().dump());
  folder.write("sensor/gnssins/egomotion2.json", egomotion().dump());
  for (const std::string camera : {"F_CAM", "L_FISH"}) {
    for (const std::string id : {"0000009", "0000010", "0000011"}) {
      folder.write("sensor/camera/" + camera + "/" + camera + "_" + id + ".jpg", "");
    }
  }
}

}  // namespace redrive::testing
