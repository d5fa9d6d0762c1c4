// SPDX-License-Identifier: Apache-2.0
// Poses of novel views: the pose of a frame, shifted along named axes, or a pose of a POSES.json.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/camera/mount.h"
#include "redrive/edit/view_requests.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The axes along which a camera is shifted.
enum class ShiftAxes {
  kBody,    ///< body axes: x forward, y left, z up
  kCamera,  ///< camera axes: x right, y down, z forward
  kLocal    ///< level: z up (normal of the WGS84 ellipsoid at the car), x the heading's horizontal
            ///< part, y left
};
std::optional<ShiftAxes> shift_axes_from_name(
    std::string_view name);  ///< "body", "camera", "local"

/// Returns the time of a frame of the recording, even of one that the run left out; nothing if
/// there is no such pose.
std::optional<std::int64_t> time_of_frame(const Scene& scene, std::int64_t frame_id);

/// Returns world_from_body when `camera` exposes its image of a frame of the recording
/// (RigCamera::time_offset_ns after the frame's time), even of a frame that the run left out;
/// nothing if there is no such pose.
std::optional<Rigid3d> world_from_body(const Scene& scene, std::int64_t frame_id,
                                       const RigCamera& camera);

/// Returns a camera's pose with the moving objects at its exposure of a frame; without them where
/// the recording has no such frame.
ShutterPoses posed_at_frame(const Scene& scene, const RigCamera& camera,
                            const Rigid3d& world_from_camera, std::int64_t frame_id);

/// Returns the exposure of a camera of the run at a frame; none where the run has no such camera or
/// the recording no such frame.
Exposure exposure_at(const Scene& scene, const std::string& camera, std::int64_t frame_id);

/// Returns the level axes at the body's position, in the world: columns x, y, z of
/// ShiftAxes::kLocal. Nothing where the pose is not on the Earth (6.2e6 to 6.6e6 m from its centre)
/// or the heading is vertical. The normal is taken as the normal of the ellipsoid through the
/// point, within 1e-6 rad of the geodetic one for heights up to 1 km.
std::optional<Eigen::Matrix3d> world_from_local_axes(const Rigid3d& global_from_world,
                                                     const Rigid3d& world_from_body);

/// Returns the world's direction up, of length 1: z where the world is metric, else the mean
/// camera's.
Eigen::Vector3d up_in_world(const Scene& scene);

/// Returns world_from_camera of a camera on the body, translated by shift_m along `axes`. Throws
/// UsageError where the local axes do not exist.
Rigid3d shifted_camera(const Rigid3d& global_from_world, const Rigid3d& world_from_body,
                       const Rigid3d& body_from_sensor, ShiftAxes axes,
                       const Eigen::Vector3d& shift_m);

/// How a sensor is moved from its place on the body.
struct SensorShift {
  Eigen::Vector3d shift_m = Eigen::Vector3d::Zero();
  ShiftAxes axes = ShiftAxes::kBody;
  double yaw_deg = 0, pitch_deg = 0;  ///< turned_sensor
};

/// Returns world_from_camera of a moved camera at a time. UsageError as shifted_camera.
Rigid3d moved_camera(const Scene& scene, const Rigid3d& body_from_camera, std::int64_t t_ns,
                     const SensorShift& shift);

/// Returns the same while a camera's rows are exposed, the middle one at a time: one pose for a
/// global shutter, else ShutterPoses::kKeys.
std::vector<Rigid3d> moved_camera_during(const Scene& scene, const RigCamera& camera,
                                         std::int64_t exposed_ns, const SensorShift& shift);

/// Returns the axes of that name. UsageError where there are none, and for kLocal where the
/// recording's poses are not in ECEF.
ShiftAxes shift_axes(const std::string& name, const Recording& recording);

/// Parses a decimal frame id, with or without leading zeros. UsageError naming `option`.
std::int64_t parse_frame(const char* option, const std::string& text);

/// Returns the exposure that --exposure asks for: none, or CAMERA:FRAME; nothing for "own".
/// UsageError.
std::optional<Exposure> chosen_exposure(const std::string& exposure, const Scene& scene);
/// Resolves --exposure for a view of `camera` at `frame`. UsageError.
Exposure exposure_of(const std::string& exposure, const Scene& scene, const std::string& camera,
                     std::int64_t frame);

/// Returns body_from_sensor turned about the camera's centre: by yaw about the body's z axis,
/// positive to the left, then by pitch about the camera's x axis, positive upwards.
Rigid3d turned_sensor(const Rigid3d& body_from_sensor, double yaw_rad, double pitch_rad);

/// Returns a user-defined camera, which exposes at the time of the frame and whose name no camera
/// of the run has; nothing where the run has no camera of the lens's name.
std::optional<RigCamera> mounted_camera(const Mount& mount, const Lens& lens, const Scene& scene);

/// Returns the cameras of a poses file: its own as recorded, or with `like_run` undistorted (except
/// fisheyes) and downscaled like the run's; the run's where the file has none.
std::vector<RigCamera> poses_rig(const ViewRequests& poses, const Scene& scene, bool like_run);

/// Returns "unknown; known are A, B; did you mean A?" for a name that no camera of the rig has.
std::string unknown_camera(const std::string& name, const std::vector<RigCamera>& rig);
/// Returns "the recording has ids from 0 to 9 ...; did you mean 9?" for an id that no frame has.
std::string unknown_frame(std::int64_t id, const Scene& scene);

/// Returns the camera of view `index` among `rig`. Throws InputError with the known names if there
/// is no such camera.
const RigCamera& requested_camera(const ViewRequests& poses, std::size_t index,
                                  const std::vector<RigCamera>& rig);

/// Returns world_from_body of view `index` of a poses file, seen by `camera`: absolute where it has
/// RT_ECEF_body (unless `prefer_shift` and it has shift_body_m, too), else the pose at the camera's
/// exposure of frame_id, shifted in body axes. Throws InputError if there is no such frame.
Rigid3d requested_world_from_body(const ViewRequests& poses, std::size_t index,
                                  const RigCamera& camera, const Scene& scene, bool prefer_shift);

}  // namespace redrive
