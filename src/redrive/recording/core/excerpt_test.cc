// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/excerpt.h"

#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// A drive whose poses are of frames 0 to 9, each a metre further, and its images of some of them.
Recording drive(const std::vector<std::vector<std::int64_t>>& images_of_cameras) {
  Recording recording;
  for (int id = 0; id < 10; ++id) {
    recording.frames.push_back({id, 100'000'000 * id, Rigid3d::Identity()});
    recording.frames.back().global_from_body.translation().x() = id;
  }
  for (const std::vector<std::int64_t>& images : images_of_cameras) {
    RecordedCamera camera;
    camera.calibration.name = "camera_" + std::to_string(recording.cameras.size());
    for (const std::int64_t id : images) camera.images.push_back({{id, ""}});
    recording.cameras.push_back(camera);
  }
  return recording;
}

std::vector<std::int64_t> ids_of(const Recording& recording) {
  std::vector<std::int64_t> ids;
  for (const FramePose& frame : recording.frames) ids.push_back(frame.id);
  return ids;
}

std::string all_findings(const Recording& recording) {
  std::string text;
  for (const Finding& finding : recording.findings)
    text += finding.subject + ": " + finding.what + "\n";
  return text;
}

TEST(Excerpt, LeavesOutFramesWithoutData) {
  Recording recording = drive({{2, 3, 4, 6}, {3, 4}});
  leave_out_empty_frames(&recording);
  report_gaps(&recording);
  EXPECT_THAT(ids_of(recording), ElementsAre(2, 3, 4, 6));
  EXPECT_EQ(all_findings(recording),
            "frames: 6 poses without an image or a scan, left out: 0, 1, 5, 7, 8, ... (6 in all); "
            "4 frames remain\n"
            "camera_1: no image of 2 frames that other cameras have: 2, 6\n");
}

TEST(Excerpt, FramesWithAScanRemain) {
  Recording recording = drive({{2, 3}});
  for (const std::int64_t id : {1, 2, 4, 12}) recording.lidar_files.push_back({id, ""});
  Recording without_extrinsics = recording;
  leave_out_empty_frames(&without_extrinsics);
  EXPECT_THAT(ids_of(without_extrinsics), ElementsAre(2, 3));

  recording.lidars = {{"lidar", Rigid3d::Identity()}};
  leave_out_empty_frames(&recording);
  report_gaps(&recording);
  EXPECT_THAT(ids_of(recording), ElementsAre(1, 2, 3, 4));
  EXPECT_THAT(all_findings(recording), HasSubstr("2 frames with a scan and no image"));
  EXPECT_THAT(all_findings(recording),
              HasSubstr("1 scan before the first frame or behind the last"));
}

TEST(Excerpt, WholeDrivesAndPhotographsStayAsTheyAre) {
  Recording whole = drive({{0, 1, 2, 3, 4, 5, 6, 7, 8, 9}}), photographs = drive({{3}}),
            nothing = drive({});
  photographs.metric = false;
  for (Recording* recording : {&whole, &photographs, &nothing}) {
    leave_out_empty_frames(recording);
    EXPECT_EQ(recording->frames.size(), 10u);
    EXPECT_TRUE(recording->findings.empty());
  }
}

TEST(Excerpt, PointsInAxesOfAFrameThatIsLeftOutAreNotUsed) {
  Recording recording = drive({{0, 2}}), later = drive({{1, 2}});
  for (Recording* each : {&recording, &later}) {
    each->points_file = "points.ply";
    leave_out_empty_frames(each);
  }
  EXPECT_EQ(recording.points_file, "points.ply");
  EXPECT_TRUE(later.points_file.empty());
  EXPECT_THAT(all_findings(later), HasSubstr("points.ply: not used"));
}

TEST(Excerpt, BoxesOfOtherFramesAreNamed) {
  Recording recording = drive({{0, 1}});
  recording.box_files = {{70, ""}, {71, ""}};
  leave_out_empty_frames(&recording);
  report_gaps(&recording);
  EXPECT_THAT(all_findings(recording), HasSubstr("boxes: not used: all 2 are of other frames"));
}

}  // namespace
}  // namespace redrive
