// SPDX-License-Identifier: Apache-2.0
// A user-defined camera on the car: its pose and its lens, as `render --mount --lens` and the
// viewer take them.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// A place on the body. With angles of 0 the camera looks along x of the body with level rows.
struct Mount {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();  ///< in body axes: forward, left, up
  double yaw_deg = 0;    ///< first, about z of the body; positive to the left
  double pitch_deg = 0;  ///< then about x of the camera; positive upwards
  double roll_deg = 0;   ///< then about z of the camera; positive clockwise, seen from behind

  Rigid3d body_from_sensor() const;
};

/// A pinhole without distortion, or the lens of a camera of the rig.
struct Lens {
  std::string camera;         ///< name; empty: a pinhole with the numbers below
  double fov_deg = 0;         ///< from the left edge of the image to the right one
  int width = 0, height = 0;  ///< pixels

  /// The pinhole, with its principal point in the middle of the image.
  Camera pinhole() const;
};

/// Parses "X,Y,Z,YAW,PITCH,ROLL"; nothing unless |coordinate| <= 1e4 m and |angle| <= 360 degrees.
std::optional<Mount> parse_mount(std::string_view text);
/// Parses "pinhole:FOV:WIDTHxHEIGHT"; nothing unless FOV is 1 to 170 degrees and the sides are 16
/// to 4096 pixels. Any other text without "pinhole:" is the name of a camera.
std::optional<Lens> parse_lens(std::string_view text);

/// Rules of the two texts, for error messages.
inline constexpr const char* kMountRule =
    "must be X,Y,Z,YAW,PITCH,ROLL: metres along the body's axes, at most 1e4, and degrees, at most "
    "360, e.g. 1.5,0,1.6,0,-5,0";
inline constexpr const char* kLensRule =
    "must be a camera of the run or pinhole:FOV:WIDTHxHEIGHT with a horizontal field of view of 1 "
    "to 170 degrees and 16 to 4096 pixels a side, e.g. pinhole:90:1280x704";

}  // namespace redrive
