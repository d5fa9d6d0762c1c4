// SPDX-License-Identifier: Apache-2.0
// A drive through a street of points and walls, without images, with known ground truth. Between
// frames the true motion is the motion of a RigModel through the true poses, so that the model is
// exact.
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/rng.h"
#include "redrive/camera/camera.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/recording.h"

namespace redrive::testing {

struct SyntheticRig {
  Recording recording;  ///< initial `frames` and ground_truth_frames; no files
  std::vector<CameraCalibration> true_cameras;
  std::vector<Track> tracks;
  std::vector<LidarSample> lidar;
};

struct SyntheticOptions {
  int frames = 40;
  double speed_m_per_s = 8;
  int points = 500;
  int lidar_points = 20'000;
  double pose_noise_m = 0.06, pose_noise_rad = 0.12 * kRadiansPerDegree;  ///< RMS about each axis
  double noise_px = 0.2, noise_m = 0.02;
  double yaw_rad = 0.15 * kRadiansPerDegree;  ///< error of the first camera's calibration
  double offset_s = 0.012;                    ///< the second camera's; not in its calibration
  double readout_s = 0;                       ///< all cameras'; not in their calibration
  bool straight = false;                      ///< at constant velocity, without bumps and sway
  bool joined = true;  ///< a point is one track of all cameras that see it, else one per camera
  bool on_surfaces = true;  ///< near points are on the LiDAR's road and walls, else between them
  std::vector<int> cameras{0, 1, 2};  ///< front pinhole, left fisheye, right fisheye
};

class SyntheticNoise {
 public:
  explicit SyntheticNoise(std::uint64_t stream) : stream_(stream) {}
  double uniform(double a, double b) {
    return a + (b - a) * random_unit(random_key(7, kStreamTest, stream_), counter_++);
  }
  double normal() {
    const double r = std::sqrt(-2 * std::log(1 - uniform(0, 1)));
    return r * std::cos(uniform(0, 2 * std::numbers::pi));
  }

 private:
  std::uint64_t stream_, counter_ = 0;
};

inline CameraCalibration synthetic_camera(int which) {
  CameraCalibration c;
  c.name = which == 0 ? "A_FRONT" : which == 1 ? "B_LEFT" : "C_RIGHT";
  c.model = which == 0 ? "opencv_pinhole" : "mei";
  if (which == 0)
    c.parameters = {300, 295, 240.5, 131, -0.2, 0.03, 0.001, 0.0005, 0};
  else
    c.parameters = {210, 212, 240.5, 131, 0.03, -0.08, 0, 0, 0, 1.02};
  c.width = 480;
  c.height = 264;
  Eigen::Matrix3d front;  // columns: the camera's axes in the body's
  front << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const double yaw = which == 0 ? 0.02 : which == 1 ? 1.3 : -1.35;
  c.body_from_sensor = Rigid3d::Identity();
  c.body_from_sensor.linear() =
      so3_exp({0, 0, yaw}) * front * so3_exp({which == 0 ? 0.01 : -0.25, 0, 0});
  c.body_from_sensor.translation() = which == 0
                                         ? Eigen::Vector3d(1.9, 0.1, 1.3)
                                         : Eigen::Vector3d(2.2, which == 1 ? 0.9 : -0.9, 1.0);
  return c;
}

inline SyntheticRig make_synthetic_rig(const SyntheticOptions& options = {}) {
  SyntheticRig rig;
  SyntheticNoise noise(1);
  Rigid3d ecef_from_street = Rigid3d::Identity();
  ecef_from_street.linear() = so3_exp({0.3, 1.1, -0.7});
  ecef_from_street.translation() = Eigen::Vector3d(4080000, 1409000, 4679000);
  // Noise: three waves of 1 to 3 s about each axis, with unit RMS together.
  std::array<std::array<double, 3>, 6> phase{}, rate{};
  for (int k = 0; k < 6; ++k)
    for (int w = 0; w < 3; ++w) {
      phase[k][w] = noise.uniform(0, 2 * std::numbers::pi);
      rate[k][w] = 2 * std::numbers::pi / noise.uniform(1, 3);
    }
  for (int f = 0; f < options.frames; ++f) {
    FramePose frame;
    frame.id = 100 + f;
    frame.t_ns = 5'000'000'000'000 + std::int64_t{66'666'667} * f;
    const double t = f / 15.0, v = options.speed_m_per_s;
    Rigid3d pose = Rigid3d::Identity();
    if (options.straight) {
      pose.translation().x() = v * t;
    } else {
      pose.linear() = so3_exp(
          {0.01 * std::sin(1.7 * t), 0.008 * std::cos(2.1 * t), 0.1 * std::sin(0.8 * t) * (v > 0)});
      pose.translation() =
          Eigen::Vector3d(v * t + 0.03 * v * std::sin(2 * t), 0.08 * v * std::sin(0.7 * t),
                          0.002 * v * std::sin(3 * t));
    }
    frame.global_from_body = ecef_from_street * pose;
    rig.recording.ground_truth_frames.push_back(frame);
    Vector6d e;
    for (int k = 0; k < 6; ++k) {
      double sum = 0;
      for (int w = 0; w < 3; ++w) sum += std::sin(rate[k][w] * t + phase[k][w]);
      e[k] = sum * std::sqrt(2.0 / 3) * (k < 3 ? options.pose_noise_m : options.pose_noise_rad);
    }
    Rigid3d error = Rigid3d::Identity();
    error.linear() = so3_exp(e.tail<3>());
    error.translation() = e.head<3>();
    frame.global_from_body = frame.global_from_body * error;
    rig.recording.frames.push_back(frame);
  }
  for (std::size_t c = 0; c < options.cameras.size(); ++c) {
    CameraCalibration camera = synthetic_camera(options.cameras[c]);
    rig.recording.cameras.push_back({camera, {}});
    if (options.cameras[c] == 0)
      rig.recording.cameras.back().calibration.body_from_sensor.linear() =
          so3_exp({0, 0, options.yaw_rad}) * camera.body_from_sensor.linear();
    if (options.cameras[c] == 1) camera.time_offset_ns = std::llround(options.offset_s * 1e9);
    camera.readout_ns = std::llround(options.readout_s * 1e9);
    rig.true_cameras.push_back(camera);
  }
  Recording ground_truth;
  ground_truth.frames = rig.recording.ground_truth_frames;
  const RigModel true_motion = make_rig_model(ground_truth);
  const Rigid3d street_from_world =
      ecef_from_street.inverse(Eigen::Isometry) * true_motion.global_from_world;
  const auto street_from_body = [&](std::int64_t t_ns) {
    return street_from_world * true_motion.motion_at(t_ns).world_from_body;
  };
  /// At the image's time plus the row's time relative to the middle row.
  const auto camera_from_street_at = [&](const CameraCalibration& camera, int f,
                                         std::int64_t later_ns) {
    const std::int64_t t_ns =
        rig.recording.ground_truth_frames[f].t_ns + camera.time_offset_ns + later_ns;
    return (street_from_body(t_ns) * camera.body_from_sensor).inverse(Eigen::Isometry);
  };
  std::vector<std::vector<Rigid3d>> camera_from_street;
  for (const CameraCalibration& camera : rig.true_cameras) {
    camera_from_street.emplace_back();
    for (int f = 0; f < options.frames; ++f)
      camera_from_street.back().push_back(camera_from_street_at(camera, f, 0));
  }
  for (int p = 0; p < options.points; ++p) {
    const bool far_away = p % 10 == 0;
    Eigen::Vector3d point(noise.uniform(-8, far_away ? 300 : 45),
                          (p % 2 ? 1 : -1) * noise.uniform(far_away ? 8 : 4, far_away ? 80 : 8),
                          noise.uniform(0, far_away ? 25 : 5));
    if (options.on_surfaces && !far_away) {
      if (p % 3 == 0)
        point = {point.x(), point.y() - (p % 2 ? 2 : -2), 0};  // the road
      else
        point.y() = p % 2 ? 7 : -7;  // a wall
    }
    Track track;
    for (std::size_t c = 0; c < rig.true_cameras.size(); ++c) {
      const Camera camera = make_camera(rig.true_cameras[c]);
      for (int f = 0; f < options.frames; ++f) {
        auto pixel = camera.project(camera_from_street[c][f] * point);
        // The time of exposure depends on the row, which depends on the time: each iteration leaves
        // at most readout x pixels per second / height of the error, 0.1 and less.
        for (int round = 0; round < 8 && options.readout_s != 0 && pixel; ++round)
          pixel = camera.project(
              camera_from_street_at(rig.true_cameras[c], f,
                                    std::llround(((pixel->y() + 0.5) / camera.height - 0.5) *
                                                 options.readout_s * 1e9)) *
              point);
        if (!pixel || pixel->x() < 0 || pixel->y() < 0 || pixel->x() > camera.width - 1 ||
            pixel->y() > camera.height - 1)
          continue;
        track.seen.push_back(
            {static_cast<int>(c), f,
             *pixel + options.noise_px * Eigen::Vector2d(noise.normal(), noise.normal())});
      }
      if (options.joined && c + 1 < rig.true_cameras.size()) continue;
      if (track.seen.size() >= 2) rig.tracks.push_back(track);
      track.seen.clear();
    }
  }
  const std::int64_t first_ns = rig.recording.frames.front().t_ns,
                     last_ns = rig.recording.frames.back().t_ns;
  for (int i = 0; i < options.lidar_points;
       ++i) {  // the road, two walls, and pillars before them that face the car
    LidarSample sample;
    sample.t_ns = first_ns + (last_ns - first_ns) * i / options.lidar_points;
    const Rigid3d pose = street_from_body(sample.t_ns);
    const double x = pose.translation().x() + noise.uniform(-15, 20), side = i % 2 ? 1 : -1;
    Eigen::Vector3d point(x, noise.uniform(-6, 6), 0);
    if (i % 3 == 1) point = {x, 7 * side, noise.uniform(0, 5)};
    if (i % 3 == 2)
      point = {4 * std::ceil(x / 4), side * noise.uniform(5.5, 7), noise.uniform(0, 4)};
    const Eigen::Vector3d in_body = pose.inverse(Eigen::Isometry) * point;
    sample.in_body = in_body + options.noise_m * noise.normal() * in_body.normalized();
    rig.lidar.push_back(sample);
  }
  return rig;
}

}  // namespace redrive::testing
