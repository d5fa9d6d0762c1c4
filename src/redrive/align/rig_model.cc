// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/rig_model.h"

#include <algorithm>
#include <cmath>

#include "redrive/align/so3.h"
#include "redrive/base/error.h"
#include "redrive/recording/trajectory.h"

namespace redrive {
namespace {

Rigid3d rigid_of(const Vector6d& v) {
  Rigid3d motion = Rigid3d::Identity();
  motion.linear() = so3_exp(v.tail<3>());
  motion.translation() = v.head<3>();
  return motion;
}

}  // namespace

Instant RigModel::at(std::int64_t t_ns) const {
  const auto after =
      std::upper_bound(given.begin(), given.end(), t_ns, [](std::int64_t t, const FramePose& f) { return t < f.t_ns; });
  Instant instant;
  instant.segment = static_cast<int>(std::clamp<std::ptrdiff_t>(after - given.begin() - 1, 0,
                                                                static_cast<std::ptrdiff_t>(given.size()) - 2));
  const FramePose &a = given[instant.segment], &b = given[instant.segment + 1];
  instant.duration_s = static_cast<double>(b.t_ns - a.t_ns) * 1e-9;
  instant.weight = static_cast<double>(t_ns - a.t_ns) * 1e-9 / instant.duration_s;
  instant.world_from_body = pose_at(given, t_ns);
  instant.velocity = instant.world_from_body.linear().transpose() *
                     (b.ecef_from_body.translation() - a.ecef_from_body.translation()) / instant.duration_s;
  instant.turn = so3_log(a.ecef_from_body.linear().transpose() * b.ecef_from_body.linear()) / instant.duration_s;
  return instant;
}

Instant RigModel::of_image(int camera, int frame) const {
  return at(given[frame].t_ns + std::llround(cameras[camera].offset_s * 1e9));
}

Rigid3d RigModel::corrected(const Instant& instant) const {
  const Vector6d &a = correction[instant.segment], &b = correction[instant.segment + 1];
  return instant.world_from_body * rigid_of(a + instant.weight * (b - a));
}

Rigid3d RigModel::body_from_sensor(int camera) const {
  return cameras[camera].given.body_from_sensor * rigid_of(cameras[camera].mount);
}

Rigid3d RigModel::world_from_camera(int camera, int frame) const {
  return corrected(of_image(camera, frame)) * body_from_sensor(camera);
}

Camera RigModel::camera(int index) const {
  Camera camera = cameras[index].camera;
  const Eigen::Vector3d& change = cameras[index].intrinsics;
  camera.fx *= 1 + change.x();
  camera.fy *= 1 + change.x();
  camera.cx += change.y();
  camera.cy += change.z();
  return camera;
}

std::vector<FramePose> RigModel::corrected_frames() const {
  std::vector<FramePose> frames = given;
  for (std::size_t i = 0; i < frames.size(); ++i)
    frames[i].ecef_from_body = ecef_from_world * given[i].ecef_from_body * rigid_of(correction[i]);
  return frames;
}

CameraCalibration RigModel::corrected_calibration(int index) const {
  CameraCalibration calibration = cameras[index].given;
  const Camera now = camera(index);
  calibration.fx = now.fx;
  calibration.fy = now.fy;
  calibration.cx = now.cx;
  calibration.cy = now.cy;
  calibration.body_from_sensor = body_from_sensor(index);
  calibration.time_offset_ns = std::llround(cameras[index].offset_s * 1e9);
  return calibration;
}

RigModel make_rig_model(const Recording& recording) {
  REDRIVE_CHECK_OP(recording.frames.size(), >=, 2u);
  RigModel model;
  model.ecef_from_world = recording.frames.front().ecef_from_body;
  model.given = recording.frames;
  for (FramePose& frame : model.given)
    frame.ecef_from_body = model.ecef_from_world.inverse(Eigen::Isometry) * frame.ecef_from_body;
  model.correction.assign(model.given.size(), Vector6d::Zero());
  for (const RecordedCamera& camera : recording.cameras) {
    RigModelCamera entry;
    entry.given = camera.calibration;
    entry.camera = make_camera(camera.calibration);
    entry.offset_s = static_cast<double>(camera.calibration.time_offset_ns) * 1e-9;
    model.cameras.push_back(entry);
  }
  return model;
}

}  // namespace redrive
