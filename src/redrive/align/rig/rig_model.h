// SPDX-License-Identifier: Apache-2.0
// The rig as the alignment adjusts it: initial poses and extrinsics, and corrections to them.
//   world_from_body(t_f) = initial_f [exp(phi_f), rho_f]
//   body_from_sensor = initial [exp(epsilon), eta]
//   A return of the LiDAR has its elevation + delta.
//   Row v of an image of frame f is exposed at t_f + offset + ((v + 1/2) / height - 1/2) readout.
// Between the frames the body moves smoothly through its corrected poses: a cubic Hermite spline
// whose slopes are the slopes of parabolas through three frames. Linear interpolation would cut the
// corners of a car that pitches and steers by 0.02 degrees at 15 Hz, and time offsets would absorb
// the error. Within a round of the adjustment the change of the corrections is linear in time
// between two frames; the next round starts from a smooth motion again. The world is the initial
// body of the first frame, since ECEF's 4e6 m would cost digits.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"
#include "redrive/math/shutter_row.h"
#include "redrive/recording/core/recording.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// A camera of the rig: its calibration and the unknowns of the adjustment.
struct RigModelCamera {
  CameraCalibration initial;
  Camera camera;
  Vector6d extrinsics = Vector6d::Zero();  ///< (eta, epsilon), in the axes of the sensor
  double offset_s = 0;   ///< exposure of the middle line minus the time of the frame's pose
  double readout_s = 0;  ///< from the upper edge to the lower one, or from the left to the right
  Eigen::Vector3d intrinsics = Eigen::Vector3d::Zero();  ///< f (1 + x), c + (y, z) pixels

  double initial_offset_s() const { return 1e-9 * static_cast<double>(initial.time_offset_ns); }
  double initial_readout_s() const { return 1e-9 * static_cast<double>(initial.readout_ns); }
  /// Exposure of a pixel of the recorded image after the middle line, as a fraction of the readout:
  /// -1/2 at the first edge, 1/2 at the last one.
  double from_middle_line(const Eigen::Vector2d& pixel) const {
    return line_fraction(initial.readout_by_column, pixel.x(), pixel.y(), camera.width,
                         camera.height) -
           0.5;
  }
};

/// The motion around a time t without corrections: (t + s) -> world_from_body [exp(angular_velocity
/// s), velocity s] between the frames `segment` and `segment` + 1. Their corrections are added with
/// weights that are linear in time; the second frame's weight is weight + s / duration_s.
struct LocalMotion {
  int segment = 0;
  double weight = 0, duration_s = 1;
  Rigid3d world_from_body = Rigid3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(),
                  angular_velocity = Eigen::Vector3d::Zero();  ///< m/s and rad/s, body axes
};

struct RigModel {
  Rigid3d global_from_world = Rigid3d::Identity();
  std::vector<PosedFrame> initial_frames;         ///< at least two
  std::vector<Vector6d> corrections;              ///< (rho, phi) by frame, body axes
  std::vector<RigModelCamera> cameras;            ///< in the order of Recording::cameras
  Rigid3d body_from_lidar = Rigid3d::Identity();  ///< the first LiDAR's
  double lidar_elevation_rad = 0;                 ///< added to the elevations of its returns

  /// The motion that, with the present corrections added, is the smooth motion. Before the first
  /// and after the last frame it continues uniformly.
  LocalMotion motion_at(std::int64_t t_ns) const;
  /// Returns the motion at an image's middle row, or its row v, with the camera's present offset
  /// and readout.
  LocalMotion image_motion(int camera, int frame) const;
  LocalMotion pixel_motion(int camera, int frame, const Eigen::Vector2d& pixel) const;

  /// The smooth motion itself, corrections included.
  LocalMotion smooth_motion_at(std::int64_t t_ns) const;

  /// Returns a return of a LiDAR with its present elevation, in the axes of the body.
  Eigen::Vector3d raised(const Eigen::Vector3d& in_body, std::size_t lidar) const;

  /// world_from_body with the present corrections.
  Rigid3d corrected_pose(const LocalMotion& motion) const;
  /// At the exposure of the middle row, or later_s after it.
  Rigid3d world_from_camera(int camera, int frame, double later_s = 0) const;
  Rigid3d body_from_sensor(int camera) const;
  Camera camera(int camera) const;  ///< with its present intrinsics

  std::vector<FramePose> corrected_frames() const;
  CameraCalibration corrected_calibration(int camera) const;
};

/// The model without corrections. At least two frames (REDRIVE_CHECK).
RigModel make_rig_model(const Recording& recording);

}  // namespace redrive
