// SPDX-License-Identifier: Apache-2.0
// For tests: a small drive with images, LiDAR and boxes.
#pragma once

#include <gtest/gtest.h>

#include "redrive/export/drive.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {

constexpr int kColumns = 512;

/// A scanner that turns once in 0.1 s, seen from above clockwise, around each frame; a car that
/// overtakes, a parked one and a person.
class MadeReader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* = nullptr) const override {
    std::vector<LidarPoint> points;
    for (int c = 0; c < columns; ++c) {
      const double fraction = (c + 0.5) / kColumns, azimuth = M_PI * (1 - 2 * fraction);
      const Eigen::Vector3d in_lidar(15 * std::cos(azimuth), 15 * std::sin(azimuth), -1);
      LidarPoint point;
      point.in_body_m = (body_from_lidar * in_lidar).cast<float>();
      point.intensity = static_cast<std::uint16_t>(c % 256);
      point.t_ns = frame(file.frame_id).t_ns + std::llround((fraction - 0.5) * 1e8) +
                   (file.path == "later" ? 100'000'000 : 0);
      if (has_ring) point.ring = 3;
      points.push_back(point);
    }
    return points;
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    const FramePose& pose = frame(file.frame_id);
    const double s = 1e-9 * static_cast<double>(pose.t_ns - frames.front().t_ns);
    std::vector<Box> boxes;
    for (const int id : {7, 8, 9}) {
      const double speed = id == 7 ? 20 : 0;
      Box box;
      box.object_id = id;
      box.type = id == 9 ? "Pedestrian" : "CAR";
      box.actor_name = "object";
      box.t_ns = pose.t_ns;
      box.size_m = {4, 2, 1.5};
      const Rigid3d global_from_box =
          frames.front().global_from_body * Eigen::Translation3d(10 + speed * s, id, 0.75) * tilt;
      box.body_from_box = pose.global_from_body.inverse() * global_from_box;
      box.velocity_in_body_m_per_s = pose.global_from_body.linear().transpose() *
                                     (speed * frames.front().global_from_body.linear().col(0) -
                                      velocity_at(frames, pose.t_ns));
      boxes.push_back(box);
    }
    return boxes;
  }

  Rigid3d body_from_lidar = Rigid3d(Eigen::Translation3d(1, 0, 1.8));
  std::vector<FramePose> frames;
  int columns = kColumns;                                    ///< columns that have returns
  bool has_ring = false;                                     ///< says the number of its only beam
  Eigen::Quaterniond tilt = Eigen::Quaterniond::Identity();  ///< turns every box

 private:
  const FramePose& frame(std::int64_t id) const {
    return *std::ranges::find(frames, id, &FramePose::id);
  }
};

/// Returns to the right of the middle of each box: 7, 8 and 9, by its id. The boxes of 2 m stand 1
/// m beside each other.
class OnObjects : public MadeReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* = nullptr) const override {
    std::vector<LidarPoint> points;
    for (const Box& box : read_boxes(file)) {
      LidarPoint point;
      point.in_body_m = (box.body_from_box * Eigen::Vector3d(0, -0.5, 0)).cast<float>();
      point.t_ns = box.t_ns;
      points.insert(points.end(), static_cast<std::size_t>(box.object_id), point);
    }
    return points;
  }
};

/// The test recording with LiDAR, boxes and a time offset of its fisheye.
class MadeDrive : public ::testing::Test {
 protected:
  MadeDrive() {
    recording_.lidars = {{"lidar", MadeReader().body_from_lidar}};
    for (const FramePose& frame : recording_.frames) {
      recording_.lidar_files.push_back({frame.id, "made"});
      recording_.box_files.push_back({frame.id, "made"});
    }
    recording_.cameras[0].calibration.time_offset_ns = 12'000'000;
    make_reader();
  }
  /// Makes a reader for the frames as they are now.
  void make_reader() {
    reader_ = std::make_shared<MadeReader>();
    reader_->frames = recording_.frames;
    recording_.reader = reader_;
  }
  Recording drive() const { return drive_of_scene(recording_, make_scene(recording_, {})); }

  TemporaryFolder folder_;
  const std::filesystem::path out_ = folder_.path / "out";
  Recording recording_ = make_test_recording(folder_.path, 5);
  std::shared_ptr<MadeReader> reader_;
  DriveNotes notes_;
  ThreadPool pool_{2};
  std::atomic<bool> stop_ = false;
};

}  // namespace redrive
