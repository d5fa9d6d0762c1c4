// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/objects_section.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/report/plot.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// A car that drives ahead of the camera FRONT, and a parked one to its left; "<" is in a type.
struct TwoCars final : RecordingReader {
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    std::vector<Box> boxes;
    for (const auto& [id, type, y, speed] :
         {std::tuple(7, "CAR", 0.0, 15.0), std::tuple(8, "<VAN>", 5.0, -15.0)}) {
      Box box{.object_id = id,
              .type = type,
              .actor_name = "",
              .t_ns = 1000000000 + (file.frame_id - 10) * 66666667ll};
      box.body_from_box = Rigid3d::Identity();
      box.body_from_box.translation() = Eigen::Vector3d(10, y, 1);
      box.size_m = {4, 2, 1.5};
      if (id == 8) box.velocity_in_body_m_per_s.x() = speed;  // the ego vehicle drives 15 m/s
      boxes.push_back(box);
    }
    return boxes;
  }
};

TEST(ObjectsSection, ShowsTracksInImagesAndFromAbove) {
  const TemporaryFolder folder;
  Recording recording = make_test_recording(folder.path);
  ThreadPool pool(1);
  EXPECT_EQ(objects_section(folder.path, recording, load_rig_images(recording, {}, 0, pool)), "");
  recording.reader = std::make_shared<TwoCars>();
  for (const FramePose& frame : recording.frames) recording.box_files.push_back({frame.id, "box"});
  const RigImages images = load_rig_images(recording, {}, 0, pool);
  const std::string section = objects_section(folder.path, recording, images);
  EXPECT_THAT(section, HasSubstr("CAR"));
  EXPECT_THAT(section, HasSubstr("&lt;VAN&gt;"));
  EXPECT_THAT(section, Not(HasSubstr("<VAN>")));
  EXPECT_THAT(section, HasSubstr("moves"));
  EXPECT_THAT(section, HasSubstr("objects_FRONT.jpg"));
  EXPECT_EQ(read_image(folder.path / "objects_FRONT.jpg").width, 24);
  EXPECT_EQ(read_image(folder.path / "figures" / "objects_above.png").width, kPlotWidth_px);
}

}  // namespace
}  // namespace redrive
