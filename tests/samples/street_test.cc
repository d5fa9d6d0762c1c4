// SPDX-License-Identifier: Apache-2.0
// The street recordings as the readers see them: complete, wrong by what tools/street/README.md says and by no more, and LiDAR,
// boxes, poses, cameras and depth of one and the same world.
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/eval/align.h"
#include "redrive/eval/novel_truth.h"
#include "redrive/recording/boxes.h"
#include "redrive/recording/las.h"
#include "redrive/recording/trajectory.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

const std::filesystem::path kStreet = REDRIVE_SAMPLES "/street", kTraffic = REDRIVE_SAMPLES "/street_traffic",
                            kRolling = REDRIVE_SAMPLES "/street_rolling";
constexpr double kDegrees = 180 / std::numbers::pi;

TEST(Street, IsComplete) {
  const Recording street = open_recording(kStreet);
  EXPECT_TRUE(street.findings.empty());
  ASSERT_EQ(street.frames.size(), 48u);
  ASSERT_EQ(street.cameras.size(), 4u);
  for (const RecordedCamera& camera : street.cameras) {
    EXPECT_EQ(camera.images.size(), 48u) << camera.calibration.name;
    EXPECT_EQ(camera.calibration.model, camera.calibration.name.starts_with("F_") ? "opencv_pinhole" : "mei");
    EXPECT_NE(camera.calibration.fx, camera.calibration.fy);
  }
  EXPECT_EQ(street.lidar_files.size(), 48u);
  EXPECT_EQ(street.novel.size(), 11u);
  EXPECT_GT(street.frames[0].ecef_from_body.translation().norm(), 6.3e6);
  EXPECT_NEAR(street.frames[1].t_ns - street.frames[0].t_ns, 1e9 / 15, 1000);
}

// Smooth noise of 6, 6 and 3 cm along the axes is 9 cm RMS, that of 0.12 degrees about each 0.21; over 3.2 s it need not
// come out exactly.
TEST(Street, WhatAProgramIsGivenIsWrongAsStated) {
  const Recording given = open_recording(kStreet), truth = open_recording(kStreet, PoseSource::kTruth);
  const Alignment rest = align_trajectories(given.frames, given.true_frames, kStreet);
  EXPECT_EQ(rest.frames, 48);
  EXPECT_GT(rest.rest_m, 0.04);
  EXPECT_LT(rest.rest_m, 0.12);
  EXPECT_GT(rest.rest_deg, 0.08);
  EXPECT_LT(rest.rest_deg, 0.3);
  for (std::size_t c = 0; c < given.cameras.size(); ++c) {
    const CameraCalibration &a = given.cameras[c].calibration, &b = truth.cameras[c].calibration;
    const Eigen::Matrix3d turn = a.body_from_sensor.linear() * b.body_from_sensor.linear().transpose();
    const double yaw_deg = Eigen::AngleAxisd(turn).angle() * kDegrees;
    EXPECT_NEAR(yaw_deg, a.name == "F_MIDRANGECAM_C" ? 0.15 : 0, 1e-6) << a.name;
    EXPECT_EQ(a.time_offset_ns, 0);
    EXPECT_EQ(b.time_offset_ns, a.name == "M_FISHEYE_L" ? -12'000'000 : 0);
    EXPECT_EQ(a.fx, b.fx);
  }
}

/// A run of the street that has not been trained: its scene is what the truth of new views is read with.
Run true_run(const std::filesystem::path& root) {
  Run run;
  run.recording = open_recording(root, PoseSource::kTruth);
  run.scene = make_scene(run.recording, {});
  return run;
}

TEST(Street, ShiftsOfTheTruePosesAreWhereTheirPosesSay) {
  const redrive::Run run = true_run(kStreet);
  for (const NovelSet& set : run.recording.novel) {
    const PosesFile poses = read_poses(set.poses_file);
    EXPECT_EQ(poses.views.size(), 6u) << set.name;
    EXPECT_EQ(NovelTruth(run, set, {}).size(), 6u) << set.name;
    for (const RequestedView& view : poses.views) {
      ASSERT_TRUE(view.ecef_from_body.has_value());
      const auto frame = std::find_if(run.recording.frames.begin(), run.recording.frames.end(),
                                      [&](const FramePose& f) { return f.id == view.frame_id; });
      ASSERT_NE(frame, run.recording.frames.end());
      const Rigid3d moved = frame->ecef_from_body.inverse(Eigen::Isometry) * *view.ecef_from_body;
      const double turned_deg = Eigen::AngleAxisd(moved.linear()).angle() * kDegrees;
      EXPECT_NEAR(turned_deg, set.name == "yaw_15" ? 15 : 0, 1e-5) << set.name;
      if (view.shift_body_m) {
        EXPECT_LT((moved.translation() - *view.shift_body_m).norm(), 1e-6) << set.name;
      }
    }
  }
}

// A LiDAR point at its own time, in a picture from half a metre aside: the picture's depth there is the point's distance, but for
// 2 cm of noise, pixels that hold an edge, and what one of the two does not see. Half of all points is far from any doubt.
TEST(Street, LidarAndDepthAreOfOneWorld) {
  const redrive::Run run = true_run(kStreet);
  const auto set = std::find_if(run.recording.novel.begin(), run.recording.novel.end(),
                                [](const NovelSet& s) { return s.name == "left_0.5"; });
  ASSERT_NE(set, run.recording.novel.end());
  const NovelTruth truth(run, *set, {});
  const PosesFile poses = read_poses(set->poses_file);
  const Rigid3d world_from_ecef = run.scene.ecef_from_world.inverse(Eigen::Isometry);
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const TruthView view = truth.load(i);
    const Rigid3d camera_from_world = view.world_from_camera.inverse(Eigen::Isometry);
    const auto file = std::find_if(run.recording.lidar_files.begin(), run.recording.lidar_files.end(),
                                   [&](const FrameFile& f) { return f.frame_id == poses.views[i].frame_id; });
    ASSERT_NE(file, run.recording.lidar_files.end());
    std::vector<double> errors;
    for (const LidarPoint& point : read_las(file->path)) {
      const Eigen::Vector3d world =
          world_from_ecef * pose_at(run.recording.frames, point.t_ns) * point.in_body_m.cast<double>();
      const Eigen::Vector3d in_camera = camera_from_world * world;
      const auto at = view.camera.project(in_camera);
      if (!at) continue;
      const long x = std::lround(at->x()), y = std::lround(at->y());
      if (x < 0 || y < 0 || x >= view.camera.width || y >= view.camera.height) continue;
      const float depth_m = view.depth_m[static_cast<std::size_t>(y) * view.camera.width + x];
      if (depth_m > 0) errors.push_back(std::abs(in_camera.norm() - depth_m) / depth_m);
    }
    ASSERT_GT(errors.size(), 100u) << view.name;
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    EXPECT_LT(errors[errors.size() / 2], 0.01) << view.name;
  }
}

TEST(Street, RevolutionsOverlapByAThird) {
  const Recording street = open_recording(kStreet);
  std::vector<LidarPoint> before;
  for (const FrameFile& file : street.lidar_files) {
    const std::vector<LidarPoint> points = read_las(file.path);
    ASSERT_FALSE(points.empty());
    EXPECT_LE(points.back().t_ns - points.front().t_ns, 100'000'000) << file.path;
    if (!before.empty()) {
      const auto shared = std::count_if(points.begin(), points.end(),
                                        [&](const LidarPoint& p) { return p.t_ns <= before.back().t_ns; });
      EXPECT_NEAR(static_cast<double>(shared) / static_cast<double>(points.size()), 1.0 / 3, 0.08) << file.path;
    }
    before = points;
  }
}

TEST(StreetRolling, IsTheFirstHalfOfTheStreetFromTheFrontCameras) {
  const Recording rolling = open_recording(kRolling, PoseSource::kTruth),
                  street = open_recording(kStreet, PoseSource::kTruth);
  EXPECT_TRUE(rolling.findings.empty());
  ASSERT_EQ(rolling.frames.size(), 24u);
  ASSERT_EQ(rolling.cameras.size(), 2u);
  for (const RecordedCamera& camera : rolling.cameras) EXPECT_EQ(camera.images.size(), 24u);
  for (std::size_t i = 0; i < rolling.frames.size(); ++i)
    EXPECT_EQ(rolling.frames[i].ecef_from_body.matrix(), street.frames[i].ecef_from_body.matrix()) << i;
}

// One of the three stands still, seen from a car that moves: its relative velocity is the ego vehicle's, reversed. Points of the
// LiDAR lie inside its box.
TEST(StreetTraffic, BoxesHoldTheirVehicles) {
  const Recording traffic = open_recording(kTraffic, PoseSource::kTruth);
  EXPECT_EQ(traffic.cameras.size(), 2u);
  EXPECT_EQ(traffic.frames.size(), 24u);
  ASSERT_EQ(traffic.box_files.size(), 24u);
  int parked = 0, inside = 0;
  for (const FrameFile& file : traffic.box_files) {
    const std::vector<Box> boxes = read_boxes(file.path);
    ASSERT_EQ(boxes.size(), 3u);
    const auto frame = std::find_if(traffic.frames.begin(), traffic.frames.end(),
                                    [&](const FramePose& f) { return f.id == file.frame_id; });
    ASSERT_NE(frame, traffic.frames.end());
    const Rigid3d later =
        frame->ecef_from_body.inverse(Eigen::Isometry) * pose_at(traffic.frames, frame->t_ns + 1'000'000);
    const auto cloud = std::find_if(traffic.lidar_files.begin(), traffic.lidar_files.end(),
                                    [&](const FrameFile& f) { return f.frame_id == file.frame_id; });
    const std::vector<LidarPoint> points = read_las(cloud->path);
    for (const Box& box : boxes) {
      EXPECT_EQ(box.t_ns, frame->t_ns);
      parked += (box.velocity_in_body_m_per_s + later.translation() / 1e-3).norm() < 0.5;
      const Rigid3d box_from_body = box.body_from_box.inverse(Eigen::Isometry);
      for (const LidarPoint& point : points) {
        const Eigen::Vector3d at_box_time =
            point.in_body_m.cast<double>() +
            1e-9 * static_cast<double>(box.t_ns - point.t_ns) * box.velocity_in_body_m_per_s;
        inside += ((box_from_body * at_box_time).cwiseAbs().array() <= box.size_m.array() / 2 + 0.05).all();
      }
    }
  }
  EXPECT_EQ(parked, 24);
  EXPECT_GT(inside, 24 * 10);
}

}  // namespace
}  // namespace redrive
