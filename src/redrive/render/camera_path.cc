// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/camera_path.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/render/view_pose.h"

namespace redrive {
namespace {

/// Velocity in the world and angular velocity in the camera's axes, or such displacements.
using Motion = Vector6d;

/// Returns the displacement from a to b.
Motion between(const PathKey& a, const PathKey& b) {
  Motion motion;
  motion << b.world_from_camera.translation() - a.world_from_camera.translation(),
      so3_log(a.world_from_camera.linear().transpose() * b.world_from_camera.linear());
  return motion;
}

/// Returns the velocity at key i of at least two.
Motion velocity_at(const std::vector<PathKey>& keys, std::size_t i) {
  const std::size_t last = keys.size() - 1;
  const auto duration = [&](std::size_t k) { return keys[k + 1].t_s - keys[k].t_s; };
  const auto mean = [&](std::size_t k) -> Motion {
    return between(keys[k], keys[k + 1]) / duration(k);
  };
  if (last == 1) return mean(0);
  // A parabola's mean velocity is the mean of its end velocities.
  if (i == 0) return 2 * mean(0) - velocity_at(keys, 1);
  if (i == last) return 2 * mean(last - 1) - velocity_at(keys, last - 1);
  return (mean(i - 1) * duration(i) + mean(i) * duration(i - 1)) / (duration(i - 1) + duration(i));
}

}  // namespace

PathKey interpolate_path(const std::vector<PathKey>& keys, double t_s) {
  REDRIVE_CHECK(!keys.empty());
  if (keys.size() == 1 || t_s <= keys.front().t_s) return keys.front();
  if (t_s >= keys.back().t_s) return keys.back();
  const auto next =
      std::upper_bound(keys.begin(), keys.end(), t_s,
                       [](double time_s, const PathKey& key) { return time_s < key.t_s; });
  const std::size_t i = static_cast<std::size_t>(next - keys.begin()) - 1;
  const PathKey &a = keys[i], &b = keys[i + 1];
  const double duration = b.t_s - a.t_s, s = (t_s - a.t_s) / duration;
  if (s == 0) return a;

  // Cumulative Bernstein polynomials of the three parts of the way.
  const double first = 1 - std::pow(1 - s, 3), second = s * s * (3 - 2 * s), third = s * s * s;
  const Motion from = velocity_at(keys, i) * duration / 3,
               to = velocity_at(keys, i + 1) * duration / 3;
  const Motion whole = between(a, b);
  const Eigen::Vector3d middle =
      so3_log(so3_exp(-from.tail<3>()) * so3_exp(whole.tail<3>()) * so3_exp(-to.tail<3>()));
  PathKey key;
  key.t_s = t_s;
  key.fov_deg = a.fov_deg + s * (b.fov_deg - a.fov_deg);
  key.drive_s = a.drive_s + s * (b.drive_s - a.drive_s);
  key.world_from_camera.translation() = a.world_from_camera.translation() + first * from.head<3>() +
                                        second * (whole.head<3>() - from.head<3>() - to.head<3>()) +
                                        third * to.head<3>();
  key.world_from_camera.linear() =
      Eigen::Quaterniond(a.world_from_camera.linear() * so3_exp(first * from.tail<3>()) *
                         so3_exp(second * middle) * so3_exp(third * to.tail<3>()))
          .normalized()
          .toRotationMatrix();
  return key;
}

int CameraPath::images() const { return std::max(1, static_cast<int>(std::lround(seconds * fps))); }

PathKey CameraPath::at_image(int index) const {
  const int steps = std::max(1, images() - 1);
  const double first = keys.front().t_s, last = keys.back().t_s;
  return interpolate_path(keys, index == steps ? last : first + index * (last - first) / steps);
}

Camera with_fov(Camera lens, double fov_deg) {
  lens.fx = lens.fy = 0.5 * lens.height / std::tan(0.5 * kRadiansPerDegree * fov_deg);
  return lens;
}

double fov_of(const Camera& lens) {
  return std::clamp(2 * std::atan(0.5 * lens.height / lens.fy) / kRadiansPerDegree, 1.0, 179.0);
}

CameraPath drive_path(const Scene& scene, const RigCamera& camera, double left_m) {
  CameraPath path;
  path.camera = camera.name;
  for (const Frame& frame : scene.frames) {
    const auto body = world_from_body(scene, frame.id, camera);
    REDRIVE_CHECK(body.has_value());
    const double t_s = 1e-9 * static_cast<double>(frame.t_ns - scene.frames.front().t_ns);
    path.keys.push_back({t_s,
                         shifted_camera(scene.global_from_world, *body, camera.body_from_sensor,
                                        ShiftAxes::kBody, Eigen::Vector3d(0, left_m, 0)),
                         0, t_s});
  }
  path.seconds = path.keys.back().t_s;
  return path;
}

PathKey path_key(const PathKeyframe& keyframe, const Scene& scene,
                 const std::filesystem::path& file, std::size_t index) {
  const auto fail = [&](const char* key, const std::string& value, const std::string& rule) {
    throw InputError(file, "keyframes[" + std::to_string(index) + "]." + key, value, rule);
  };
  const int camera = scene.camera_index(keyframe.camera);
  if (camera < 0) fail("camera", keyframe.camera, unknown_camera(keyframe.camera, scene.rig));
  const RigCamera& of_rig = scene.rig[camera];
  const auto body = world_from_body(scene, keyframe.frame_id, of_rig);
  if (!body)
    fail("frame_id", std::to_string(keyframe.frame_id), unknown_frame(keyframe.frame_id, scene));
  const Rigid3d body_from_sensor =
      turned_sensor(of_rig.body_from_sensor, kRadiansPerDegree * keyframe.yaw_deg,
                    kRadiansPerDegree * keyframe.pitch_deg);
  return {keyframe.time_s,
          shifted_camera(scene.global_from_world, *body, body_from_sensor, ShiftAxes::kBody,
                         Eigen::Vector3d(keyframe.shift_body_m.data())),
          0, static_cast<double>(exposure_at(scene, keyframe.camera, keyframe.frame_id).t_s)};
}

CameraPath path_of_file(const CameraPathFile& file, const Scene& scene) {
  CameraPath path;
  path.fps = file.fps;
  path.seconds = file.seconds;
  for (std::size_t i = 0; i < file.keyframes.size(); ++i)
    path.keys.push_back(path_key(file.keyframes[i], scene, file.path, i));
  if (!file.keyframes.empty()) {
    path.camera = file.keyframes.front().camera;
    return path;
  }
  for (std::size_t i = 0; i < file.cameras.size(); ++i)
    path.keys.push_back({static_cast<double>(i) / file.fps, file.cameras[i].world_from_camera,
                         file.cameras[i].fov_deg, 0});
  Camera lens;
  if (file.fisheye)
    lens.model = OpenCvFisheye{};
  else
    lens.model = OpenCvPinhole{};
  lens.width = file.width;
  lens.height = file.height;
  lens.cx = 0.5 * (file.width - 1);
  lens.cy = 0.5 * (file.height - 1);
  path.lens = with_fov(lens, 90);
  return path;
}

Exposure path_exposure(const CameraPath& path, const Scene& scene, int camera) {
  const Eigen::Vector3d middle = path.at_image(path.images() / 2).world_from_camera.translation();
  const Frame* nearest = nullptr;
  double least = std::numeric_limits<double>::infinity();
  for (const Frame& frame : scene.frames) {
    const double distance =
        ((scene.world_from_body(frame.t_ns) * scene.rig[camera].body_from_sensor).translation() -
         middle)
            .norm();
    if (distance < least) {
      least = distance;
      nearest = &frame;
    }
  }
  return scene.exposure(camera, nearest->t_ns);
}

}  // namespace redrive
