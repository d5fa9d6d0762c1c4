// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/lidar_images.h"

#include <gtest/gtest.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

/// A standing sensor 20 m before a wall; frame 12 is held out.
class LidarImages : public ::testing::Test {
 protected:
  LidarImages() {
    auto model = std::make_unique<NerfModel>();
    model->config.width = 32;
    model->samples = 4;
    model->parameters = Buffer<float>(nerf_parameter_count(model->config));
    run_.state.model = std::move(model);
    run_.recording = make_test_recording(folder_.path, 4);
    Recording& recording = run_.recording;
    recording.reader = aimotive::make_reader();
    recording.body_from_lidar = Rigid3d::Identity();
    for (FramePose& frame : recording.frames)
      frame.global_from_body = recording.frames[0].global_from_body;
    for (const FramePose& frame : recording.frames) {
      std::vector<LidarRecord> points;
      for (int i = -20; i < 20; ++i) points.push_back({{20, 0.53 * i, 0.31 * (i % 7)}, frame.t_ns});
      const std::string name = "frame_" + std::to_string(frame.id) + ".las";
      folder_.write(name, make_las(points));
      recording.lidar_files.push_back({frame.id, folder_.path / name});
    }
    run_.scene = make_scene(recording, {});
    for (View& view : run_.scene.views) view.held_out = view.frame == 2;
  }
  std::vector<ImageRow> images(float wall_m) {
    PaintBackend backend([](const auto&, const auto&) { return std::array<float, 3>{}; },
                         [&](const auto&, const auto& direction) { return wall_m / direction[0]; });
    return lidar_image_rows(run_, backend);
  }

  TemporaryFolder folder_;
  redrive::Run run_;
};

TEST_F(LidarImages, ShowTheRecordedScanBesideTheRenderedOne) {
  std::vector<ImageRow> rows = images(20);
  ASSERT_EQ(rows.size(), 2u) << "no intensities";
  for (const ImageRow& row : rows) {
    EXPECT_NE(row.title.find("LiDAR, frame 12, held out"), std::string::npos) << row.title;
    ASSERT_EQ(row.images.size(), 2u);
    std::size_t painted = 0;
    for (std::size_t i = 0; i < row.images[0].image.rgb.size(); i += 3)
      painted += row.images[0].image.rgb[i + 2] != 40;
    EXPECT_GE(painted, 40u);
  }
  EXPECT_EQ(rows[0].images[0].image.rgb, rows[0].images[1].image.rgb);
  rows = images(30);
  EXPECT_NE(rows[0].images[0].image.rgb, rows[0].images[1].image.rgb) << "another range";
  EXPECT_NE(rows[1].images[0].image.rgb, rows[1].images[1].image.rgb) << "another place";
}

TEST_F(LidarImages, AreNoneWhereNoScanIsHeldOut) {
  for (View& view : run_.scene.views) view.held_out = false;
  EXPECT_TRUE(images(20).empty());
}

}  // namespace
}  // namespace redrive
