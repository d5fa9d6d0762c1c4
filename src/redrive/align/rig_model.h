// SPDX-License-Identifier: Apache-2.0
// What align moves: the egomotion as given, and the corrections to it and to the cameras.
//   world_from_body(t) = given(t) [exp(phi(t)), rho(t)],  (rho, phi)(t) linear between the frames' corrections
//   body_from_sensor   = given [exp(epsilon), eta],       an image of frame f is exposed at t_f + offset
// so that the egomotion's own motion between the frames is kept. given(t) goes through the frames' poses smoothly (cubic Hermite, with
// the slopes of parabolas through three frames): a straight line would cut the corners of a car that pitches and steers by 0.02 degrees
// at 15 Hz, and time offsets would make up for it. The world
// is the body of the first frame as given: metres near 0, where ECEF's 4e6 would cost digits.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/recording/recording.h"

namespace redrive {

using Vector6d = Eigen::Matrix<double, 6, 1>;  ///< metres x y z, then radians about x y z

/// A camera of the rig: what is known and what is sought.
struct RigModelCamera {
  CameraCalibration given;
  Camera camera;
  Vector6d mount = Vector6d::Zero();                      ///< (eta, epsilon): in the axes of the sensor
  double offset_s = 0;                                    ///< exposure minus the time of the frame's pose
  Eigen::Vector3d intrinsics = Eigen::Vector3d::Zero();  ///< f (1 + x), c + (y, z) pixels
};

/// The given motion around one instant: given(t + s) = world_from_body [exp(turn s), velocity s] while it stays between the
/// two frames `segment` and `segment` + 1, where the weight of the second one's correction is weight + s / duration_s.
struct Instant {
  int segment = 0;
  double weight = 0, duration_s = 1;
  Rigid3d world_from_body = Rigid3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();  ///< m/s and rad/s, body axes
};

struct RigModel {
  Rigid3d ecef_from_world = Rigid3d::Identity();
  std::vector<FramePose> given;      ///< in the world: ecef_from_body stands for world_from_body; at least two
  std::vector<Vector6d> correction;  ///< (rho, phi) by frame, body axes
  std::vector<RigModelCamera> cameras;

  /// Before the first and after the last frame the motion there goes on, evenly.
  Instant at(std::int64_t t_ns) const;
  /// Of an image: where the camera's offset of now puts it.
  Instant of_image(int camera, int frame) const;

  Rigid3d corrected(const Instant& instant) const;  ///< world_from_body with the corrections of now
  Rigid3d world_from_camera(int camera, int frame) const;
  Rigid3d body_from_sensor(int camera) const;
  Camera camera(int camera) const;                  ///< with its intrinsics of now

  std::vector<FramePose> corrected_frames() const;  ///< in ECEF
  CameraCalibration corrected_calibration(int camera) const;
};

/// Without corrections. At least two frames (REDRIVE_CHECK).
RigModel make_rig_model(const Recording& recording);

}  // namespace redrive
