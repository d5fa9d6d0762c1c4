// SPDX-License-Identifier: Apache-2.0
// Calibration files of KITTI-360, in `calibration` of the data set: perspective.txt (P_rect, R_rect
// and S_rect of the stereo cameras), image_02.yaml and image_03.yaml (fisheyes), and
// calib_cam_to_pose.txt and calib_cam_to_velo.txt (3 x 4 matrices).
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>

#include "redrive/camera/calibration.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"

namespace redrive::kitti360 {

/// A camera whose images are rectified: a pinhole at its own place, turned.
struct PerspectiveCamera {
  kitti::RectifiedCamera projection;  ///< the fourth column of P_rect is not used
  Rigid3d rectified_from_camera;      ///< R_rect
};

/// Returns cameras 0 and 1, if they have a P_rect_0X. InputError as kitti::parse_cam_to_cam.
std::map<int, PerspectiveCamera> parse_perspective(std::string_view text,
                                                   const std::filesystem::path& file);

/// A lens of the model of Mei and Rives, from YAML as OpenCV writes it: image_width, image_height,
/// mirror_parameters.xi, distortion_parameters.k1 k2 p1 p2, projection_parameters.gamma1 gamma2 u0
/// v0. Sets model, parameters and size. InputError: another model_type, missing keys, a key twice,
/// values that are no finite numbers or out of the model's range.
CameraCalibration parse_fisheye(std::string_view text, const std::filesystem::path& file);

/// Returns IMU from camera, keyed by the cameras' folder names. InputError as kitti::parse_rigid.
std::map<std::string, Rigid3d> parse_cam_to_pose(std::string_view text,
                                                 const std::filesystem::path& file);

/// Velodyne from camera 0 before rectification: one line of 12 numbers.
Rigid3d parse_cam_to_velo(std::string_view text, const std::filesystem::path& file);

}  // namespace redrive::kitti360
