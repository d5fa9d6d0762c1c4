// SPDX-License-Identifier: Apache-2.0
// Calibration files of KITTI: lines "KEY: numbers". Raw drives have calib_cam_to_cam.txt,
// calib_velo_to_cam.txt and calib_imu_to_velo.txt beside the drives of a day; sequences of the
// odometry benchmark have calib.txt with P0..P3 and Tr, sequences of the tracking benchmark
// calib/<sequence>.txt with P0..P3, R_rect, Tr_velo_cam and Tr_imu_velo.
//
// Images are rectified. A point x in the axes of the rectified camera 0 projects to P (x, 1) = K (x
// + t): a pinhole of K with the axes of camera 0, t away from it.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/math/rigid3.h"
#include "redrive/recording/formats/image_size.h"

namespace redrive::kitti {

/// A 3 x 4 projection matrix.
struct RectifiedCamera {
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  Rigid3d camera_from_rectified = Rigid3d::Identity();
  std::optional<ImageSize> size;  ///< S_rect; calib.txt has none
};
using RectifiedCameras = std::map<int, RectifiedCamera>;  ///< key: number, 0 to 3

struct CamToCam {
  Rigid3d rectified_from_camera;  ///< R_rect_00
  RectifiedCameras cameras;       ///< cameras with a P_rect_0X
};

/// Calibration of a sequence of the tracking benchmark.
struct TrackingCalibration {
  RectifiedCameras cameras;       ///< cameras with a PX
  Rigid3d rectified_from_camera;  ///< R_rect
  Rigid3d camera_from_velodyne;   ///< Tr_velo_cam
  Rigid3d velodyne_from_imu;      ///< Tr_imu_velo
};

struct OdometryCalibration {
  RectifiedCameras cameras;                        ///< cameras with a PX
  std::optional<Rigid3d> rectified_from_velodyne;  ///< Tr
};

/// InputError: lines without a key, a key twice, missing keys, wrong numbers of values, values that
/// are no finite numbers, sizes and focal lengths out of range, matrices that are no projection of
/// a rectified image, rotations that are none, sensors more than 50 m apart.
CamToCam parse_cam_to_cam(std::string_view text, const std::filesystem::path& file);
OdometryCalibration parse_odometry_calibration(std::string_view text,
                                               const std::filesystem::path& file);
/// Keys without a colon are read, too, and R0_rect, Tr_velo_to_cam and Tr_imu_to_velo, as the
/// detection benchmark calls them.
TrackingCalibration parse_tracking_calibration(std::string_view text,
                                               const std::filesystem::path& file);
/// R and T of calib_velo_to_cam.txt (camera 0 from Velodyne) or calib_imu_to_velo.txt (Velodyne
/// from IMU).
Rigid3d parse_rigid(std::string_view text, const std::filesystem::path& file);

// ---- Parts of such files; errors as above

/// A finite number, else the word as a text, which a field's reader names.
nlohmann::json value_of(std::string_view word);
/// Returns {"KEY": [values]}, so that fields are read and named as in other calibrations.
nlohmann::json key_values(std::string_view text, const std::filesystem::path& file,
                          bool needs_colon = true);
/// Makes a transform from 9 numbers of the rotation and 3 of the translation, row by row. `name`:
/// for messages.
Rigid3d rigid_from_numbers(const std::vector<double>& rotation,
                           const std::vector<double>& translation, const std::string& name,
                           const std::filesystem::path& file);
/// A P_rect of 12 numbers.
RectifiedCamera camera_from_projection(const JsonField& field, std::optional<ImageSize> size);
/// An S_rect of two numbers.
ImageSize size_from_json(const JsonField& field);

}  // namespace redrive::kitti
