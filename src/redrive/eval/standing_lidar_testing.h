// SPDX-License-Identifier: Apache-2.0
// For tests: an untrained run of a drive that stands still, with LiDAR scans.
#pragma once

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/run.h"

namespace redrive {

/// Frames 10 to 13, of which 12 is held out. The sensor is the body.
class StandingLidarTest : public ::testing::Test {
 protected:
  explicit StandingLidarTest(const std::vector<Eigen::Vector3d>& points) {
    run_.state.model = make_painted_model();
    run_.recording = make_test_recording(folder_.path, 4);
    Recording& recording = run_.recording;
    recording.reader = aimotive::make_reader();
    recording.lidars = {{"lidar", Rigid3d::Identity()}};
    for (FramePose& frame : recording.frames) {
      frame.global_from_body = recording.frames[0].global_from_body;
      recording.lidar_files.push_back(
          {frame.id, folder_.path / ("frame_" + std::to_string(frame.id) + ".las")});
    }
    std::vector<LidarRecord> scan;
    for (const Eigen::Vector3d& point : points) scan.push_back({point});
    write_scans(scan);
    run_.scene = make_scene(recording, {});
    for (View& view : run_.scene.views) view.held_out = view.frame == 2;
  }
  /// Writes the scan of every frame, at its time.
  void write_scans(std::vector<LidarRecord> scan) {
    for (std::size_t f = 0; f < run_.recording.frames.size(); ++f) {
      for (LidarRecord& point : scan) point.t_ns = run_.recording.frames[f].t_ns;
      write_file(run_.recording.lidar_files[f].path, make_las(scan));
    }
  }

  TemporaryFolder folder_;
  redrive::Run run_;
};

}  // namespace redrive
