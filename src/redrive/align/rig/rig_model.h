// SPDX-License-Identifier: Apache-2.0
// What align moves: the egomotion as given, and the corrections to it and to the cameras.
//   world_from_body(t_f) = given_f [exp(phi_f), rho_f],   body_from_sensor = given [exp(epsilon),
//   eta], row v of an image of frame f is exposed at t_f + offset + ((v + 1/2) / height - 1/2)
//   readout.
// Between the frames the body moves smoothly through its corrected poses (cubic Hermite, slopes of
// parabolas through three frames): a straight line would cut the corners of a car that pitches and
// steers by 0.02 degrees at 15 Hz, and time offsets would make up for it. While the corrections of
// a round change, what they add is linear between two frames; the next round is smooth again. The
// world is the body of the first frame as given: metres near 0, where ECEF's 4e6 would cost digits.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/recording/recording.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

using Vector6d = Eigen::Matrix<double, 6, 1>;  ///< metres x y z, then radians about x y z

/// A camera of the rig: what is known and what is sought.
struct RigModelCamera {
  CameraCalibration given;
  Camera camera;
  Vector6d mount = Vector6d::Zero();  ///< (eta, epsilon): in the axes of the sensor
  double offset_s = 0;   ///< exposure of the middle row minus the time of the frame's pose
  double readout_s = 0;  ///< from the upper edge to the lower one
  Eigen::Vector3d intrinsics = Eigen::Vector3d::Zero();  ///< f (1 + x), c + (y, z) pixels

  double initial_offset_s() const { return 1e-9 * static_cast<double>(given.time_offset_ns); }
  double initial_readout_s() const { return 1e-9 * static_cast<double>(given.readout_ns); }
  /// Of the readout, by which row v of the recorded image comes after the middle one: -1/2 at the
  /// upper edge, 1/2 at the lower one.
  double from_middle_row(double v) const { return row_fraction(v, camera.height) - 0.5; }
};

/// The motion around one instant without corrections: (t + s) -> world_from_body [exp(turn s),
/// velocity s] while it stays between the two frames `segment` and `segment` + 1, whose corrections
/// are added with weights that are linear in time, that of the second one weight + s / duration_s.
struct Instant {
  int segment = 0;
  double weight = 0, duration_s = 1;
  Rigid3d world_from_body = Rigid3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(),
                  turn = Eigen::Vector3d::Zero();  ///< m/s and rad/s, body axes
};

struct RigModel {
  Rigid3d global_from_world = Rigid3d::Identity();
  std::vector<FramePose>
      given;  ///< in the world: global_from_body stands for world_from_body; at least two
  std::vector<Vector6d> correction;  ///< (rho, phi) by frame, body axes
  std::vector<RigModelCamera> cameras;

  /// With the corrections of now added again it is the smooth motion. Before the first and after
  /// the last frame that goes on evenly.
  Instant at(std::int64_t t_ns) const;
  /// Of an image's middle row, or its row v: where the camera's offset and readout of now put it.
  Instant of_image(int camera, int frame) const;
  Instant of_row(int camera, int frame, double v) const;

  Instant smooth_at(std::int64_t t_ns) const;  ///< the smooth motion itself, corrections included

  Rigid3d corrected(const Instant& instant) const;  ///< world_from_body with the corrections of now
  /// Of the middle row, or so much later.
  Rigid3d world_from_camera(int camera, int frame, double later_s = 0) const;
  Rigid3d body_from_sensor(int camera) const;
  Camera camera(int camera) const;  ///< with its intrinsics of now

  std::vector<FramePose> corrected_frames() const;  ///< in ECEF
  CameraCalibration corrected_calibration(int camera) const;
};

/// Without corrections. At least two frames (REDRIVE_CHECK).
RigModel make_rig_model(const Recording& recording);

}  // namespace redrive
