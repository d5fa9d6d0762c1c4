// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/view_pose.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/wgs84.h"

namespace redrive {
namespace {

std::string view_field(std::size_t index, const char* key) {
  return "images[" + std::to_string(index) + "]." + key;
}

}  // namespace

std::optional<ShiftAxes> shift_axes_from_name(std::string_view name) {
  if (name == "body") return ShiftAxes::kBody;
  if (name == "camera") return ShiftAxes::kCamera;
  if (name == "local") return ShiftAxes::kLocal;
  return std::nullopt;
}

namespace {

const FramePose* find_frame(const Scene& scene, std::int64_t id) {
  const auto frame = std::ranges::find(scene.trajectory, id, &FramePose::id);
  return frame == scene.trajectory.end() ? nullptr : &*frame;
}

}  // namespace

std::optional<std::int64_t> time_of_frame(const Scene& scene, std::int64_t frame_id) {
  const FramePose* const frame = find_frame(scene, frame_id);
  return frame ? std::optional(frame->t_ns) : std::nullopt;
}

Exposure exposure_at(const Scene& scene, const std::string& camera, std::int64_t frame_id) {
  const int index = scene.camera_index(camera);
  const FramePose* const frame = find_frame(scene, frame_id);
  return index >= 0 && frame ? scene.exposure(index, frame->t_ns) : Exposure{};
}

ShutterPoses posed_at_frame(const Scene& scene, const RigCamera& camera,
                            const Rigid3d& world_from_camera, std::int64_t frame_id) {
  const FramePose* const frame = find_frame(scene, frame_id);
  return frame ? scene.with_actors(world_from_camera, camera, frame->t_ns)
               : ShutterPoses(world_from_camera);
}

std::optional<Rigid3d> world_from_body(const Scene& scene, std::int64_t frame_id,
                                       const RigCamera& camera) {
  const FramePose* const frame = find_frame(scene, frame_id);
  if (!frame) return std::nullopt;
  return scene.world_from_body(frame->t_ns + camera.time_offset_ns);
}

std::optional<Eigen::Matrix3d> world_from_local_axes(const Rigid3d& global_from_world,
                                                     const Rigid3d& world_from_body) {
  const Rigid3d global_from_body = global_from_world * world_from_body;
  const Eigen::Vector3d position = global_from_body.translation();
  if (position.norm() < 6.2e6 || position.norm() > 6.6e6) return std::nullopt;
  constexpr double a2 = kWgs84SemiMajor_m * kWgs84SemiMajor_m,
                   b2 = kWgs84SemiMinor_m * kWgs84SemiMinor_m;
  const Eigen::Vector3d up =
      Eigen::Vector3d(position.x() / a2, position.y() / a2, position.z() / b2).normalized();
  const Eigen::Vector3d heading = global_from_body.linear().col(0);
  const Eigen::Vector3d level = heading - heading.dot(up) * up;
  if (level.norm() < 1e-6) return std::nullopt;
  Eigen::Matrix3d ecef_from_local;
  ecef_from_local.col(0) = level.normalized();
  ecef_from_local.col(1) = up.cross(ecef_from_local.col(0));
  ecef_from_local.col(2) = up;
  return global_from_world.linear().transpose() * ecef_from_local;
}

Eigen::Vector3d up_in_world(const Scene& scene) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  if (!scene.metric)
    for (const View& view : scene.views) sum -= scene.world_from_camera(view).linear().col(1);
  return sum.norm() > 1e-3 ? sum.normalized() : Eigen::Vector3d::UnitZ();
}

Rigid3d shifted_camera(const Rigid3d& global_from_world, const Rigid3d& world_from_body,
                       const Rigid3d& body_from_sensor, ShiftAxes axes,
                       const Eigen::Vector3d& shift_m) {
  Rigid3d world_from_camera = world_from_body * body_from_sensor;
  Eigen::Matrix3d world_from_axes = Eigen::Matrix3d::Identity();
  switch (axes) {
    case ShiftAxes::kBody: world_from_axes = world_from_body.linear(); break;
    case ShiftAxes::kCamera: world_from_axes = world_from_camera.linear(); break;
    case ShiftAxes::kLocal: {
      const auto local = world_from_local_axes(global_from_world, world_from_body);
      if (!local)
        throw UsageError("--axes", "local",
                         "the poses of this recording are not near the Earth's surface or head "
                         "straight up, so there is no level frame; use body or camera");
      world_from_axes = *local;
    }
  }
  world_from_camera.pretranslate(world_from_axes * shift_m);
  return world_from_camera;
}

Rigid3d turned_sensor(const Rigid3d& body_from_sensor, double yaw_rad, double pitch_rad) {
  Rigid3d turned = body_from_sensor;
  turned.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
                    body_from_sensor.linear() *
                    Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitX()).toRotationMatrix();
  return turned;
}

Rigid3d moved_camera(const Scene& scene, const Rigid3d& body_from_camera, std::int64_t t_ns,
                     const SensorShift& shift) {
  return shifted_camera(scene.global_from_world, scene.world_from_body(t_ns),
                        turned_sensor(body_from_camera, kRadiansPerDegree * shift.yaw_deg,
                                      kRadiansPerDegree * shift.pitch_deg),
                        shift.axes, shift.shift_m);
}

std::vector<Rigid3d> moved_camera_during(const Scene& scene, const RigCamera& camera,
                                         std::int64_t exposed_ns, const SensorShift& shift) {
  const int keys = camera.readout_ns == 0 ? 1 : ShutterPoses::kKeys;
  std::vector<Rigid3d> poses;
  for (int key = 0; key < keys; ++key) {
    const double part = keys == 1 ? 0 : key / (keys - 1.0) - 0.5;
    poses.push_back(moved_camera(
        scene, camera.body_from_sensor,
        exposed_ns + std::llround(part * static_cast<double>(camera.readout_ns)), shift));
  }
  return poses;
}

ShiftAxes shift_axes(const std::string& name, const Recording& recording) {
  const std::optional<ShiftAxes> axes = shift_axes_from_name(name);
  if (!axes) throw UsageError("--axes", name, "must be body, camera or local");
  if (*axes == ShiftAxes::kLocal && recording.global_frame != GlobalFrame::kEcef)
    throw UsageError("--axes", name,
                     "needs a recording whose poses are in ECEF; use body or camera");
  return *axes;
}

std::int64_t parse_frame(const char* option, const std::string& text) {
  std::int64_t id = -1;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  if (error != std::errc{} || end != text.data() + text.size() || id < 0)
    throw UsageError(option, text, "must be a frame id, a whole number from 0");
  return id;
}

std::optional<Exposure> chosen_exposure(const std::string& exposure, const Scene& scene) {
  if (exposure == "own") return std::nullopt;
  if (exposure == "none") return Exposure{};
  const std::size_t colon = exposure.find(':');
  const auto fail = [&](const std::string& rule) -> void {
    throw UsageError("--exposure", exposure, rule);
  };
  if (colon == std::string::npos) fail("must be own, none or CAMERA:FRAME");
  const Exposure chosen = exposure_at(scene, exposure.substr(0, colon),
                                      parse_frame("--exposure", exposure.substr(colon + 1)));
  if (chosen.camera < 0) fail("the run has no such camera or the recording no such frame");
  return chosen;
}

Exposure exposure_of(const std::string& exposure, const Scene& scene, const std::string& camera,
                     std::int64_t frame) {
  const std::optional<Exposure> chosen = chosen_exposure(exposure, scene);
  return chosen ? *chosen : exposure_at(scene, camera, frame);
}

std::optional<RigCamera> mounted_camera(const Mount& mount, const Lens& lens, const Scene& scene) {
  RigCamera mounted;
  mounted.name = "mount:" + lens.camera;
  mounted.body_from_sensor = mount.body_from_sensor();
  if (lens.camera.empty()) {
    mounted.camera = mounted.recorded = lens.pinhole();
    return mounted;
  }
  const int index = scene.camera_index(lens.camera);
  if (index < 0) return std::nullopt;
  mounted.camera = scene.rig[index].camera;
  mounted.recorded = scene.rig[index].recorded;
  return mounted;
}

std::vector<RigCamera> poses_rig(const ViewRequests& poses, const Scene& scene, bool like_run) {
  if (poses.cameras.empty()) return scene.rig;
  std::vector<RigCamera> rig;
  for (const CameraCalibration& calibration : poses.cameras) {
    RigCamera camera{calibration.name,
                     make_camera(calibration),
                     make_camera(calibration),
                     calibration.body_from_sensor,
                     calibration.time_offset_ns,
                     calibration.readout_ns,
                     calibration.readout_by_column};
    if (like_run && scene.undistort && camera.camera.info().perspective)
      camera.camera = camera.camera.undistorted();
    if (like_run) camera.camera = camera.camera.downscaled(scene.downscale);
    rig.push_back(std::move(camera));
  }
  return rig;
}

std::string unknown_camera(const std::string& name, const std::vector<RigCamera>& rig) {
  std::vector<std::string> names;
  for (const RigCamera& camera : rig) names.push_back(camera.name);
  return unknown_name(name, names);
}

std::string unknown_frame(std::int64_t id, const Scene& scene) {
  const std::vector<FramePose>& frames = scene.trajectory;
  const auto nearest = std::ranges::min_element(
      frames, {}, [&](const FramePose& frame) { return std::abs(frame.id - id); });
  return "the recording has no such frame with a pose; it has ids from " +
         std::to_string(frames.front().id) + " to " + std::to_string(frames.back().id) +
         "; did you mean " + std::to_string(nearest->id) + "?";
}

const RigCamera& requested_camera(const ViewRequests& poses, std::size_t index,
                                  const std::vector<RigCamera>& rig) {
  const std::string& name = poses.views[index].camera;
  const auto found = std::ranges::find(rig, name, &RigCamera::name);
  if (found != rig.end()) return *found;
  throw InputError(poses.path, view_field(index, "camera"), name, unknown_camera(name, rig));
}

Rigid3d requested_world_from_body(const ViewRequests& poses, std::size_t index,
                                  const RigCamera& camera, const Scene& scene, bool prefer_shift) {
  const RequestedView& view = poses.views[index];
  if (view.global_from_body && !(prefer_shift && view.shift_body_m))
    return scene.global_from_world.inverse(Eigen::Isometry) * *view.global_from_body;
  REDRIVE_CHECK(view.shift_body_m.has_value());
  const auto pose = world_from_body(scene, view.frame_id, camera);
  if (!pose)
    throw InputError(poses.path, view_field(index, "frame_id"), std::to_string(view.frame_id),
                     "shift_body_m moves a frame; " + unknown_frame(view.frame_id, scene));
  return *pose * Eigen::Translation3d(*view.shift_body_m);
}

}  // namespace redrive
