// SPDX-License-Identifier: Apache-2.0
// Drives in other formats, read back.
#include "redrive/export/drive.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/export/made_drive_testing.h"
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

class DriveTest : public MadeDrive {
 protected:
  template <class Write>
  Recording written(const Write& write) {
    notes_ = write(out_, drive(), pool_, stop_);
    return open_recording(out_);
  }
  Eigen::Vector3d in_first_body(const Recording& recording, const LidarPoint& point) const {
    return recording.frames[0].global_from_body.inverse() *
           (pose_at(recording.frames, point.t_ns) * point.in_body_m.cast<double>());
  }
};

/// Compares the poses of every image and the rays of every pixel, by camera index of `now`.
void expect_same_rays(const Recording& recording, const Recording& now,
                      const std::vector<int>& camera_of) {
  const Scene before = make_scene(recording, {}), after = make_scene(now, {});
  ASSERT_EQ(before.views.size(), after.views.size());
  const std::size_t frames = recording.frames.size();
  for (std::size_t v = 0; v < after.views.size(); ++v) {
    const View& view = after.views[v];
    const auto was = static_cast<std::size_t>(camera_of[static_cast<std::size_t>(view.camera)]);
    const View& same = before.views[was * frames + static_cast<std::size_t>(view.frame)];
    const Rigid3d expected = before.world_from_camera(same), found = after.world_from_camera(view);
    EXPECT_LT((expected.translation() - found.translation()).norm(), 1e-6) << v;
    EXPECT_LT((expected.linear() - found.linear()).norm(), 1e-6) << v;
  }
}

TEST_F(DriveTest, AimotiveComesBack) {
  const Recording now = written(write_aimotive);
  EXPECT_EQ(now.format, "aimotive");
  EXPECT_TRUE(now.findings.empty()) << now.findings[0].what;
  expect_same_rays(recording_, now, {0, 1});
  for (std::size_t c = 0; c < 2; ++c) {
    EXPECT_EQ(now.cameras[c].calibration.parameters, recording_.cameras[c].calibration.parameters);
    EXPECT_EQ(read_file(now.cameras[c].images[3].path),
              read_file(recording_.cameras[c].images[3].path));
  }
  ASSERT_EQ(now.lidar_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto points = now.reader->read_lidar(now.lidar_files[f]),
               were = recording_.reader->read_lidar(recording_.lidar_files[f]);
    ASSERT_EQ(points.size(), were.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_LT((points[i].in_body_m - were[i].in_body_m).norm(), 2e-6f);
      EXPECT_EQ(points[i].t_ns, were[i].t_ns);
      EXPECT_EQ(points[i].intensity, were[i].intensity);
    }
    const auto boxes = now.reader->read_boxes(now.box_files[f]),
               boxed = recording_.reader->read_boxes(recording_.box_files[f]);
    ASSERT_EQ(boxes.size(), 3u);
    for (std::size_t b = 0; b < 3; ++b) {
      EXPECT_TRUE(boxes[b].body_from_box.isApprox(boxed[b].body_from_box, 1e-9));
      EXPECT_TRUE(boxes[b].velocity_in_body_m_per_s.isApprox(boxed[b].velocity_in_body_m_per_s));
      EXPECT_EQ(boxes[b].type, boxed[b].type);
    }
  }
}

TEST_F(DriveTest, AimotiveJoinsRevolutionsOfAFrame) {
  recording_.lidar_files.insert(recording_.lidar_files.begin() + 1,
                                {recording_.frames[0].id, "later"});
  const Recording now = written(write_aimotive);
  ASSERT_EQ(now.lidar_files.size(), 5u);
  const auto points = now.reader->read_lidar(now.lidar_files[0]);
  ASSERT_EQ(points.size(), 2u * kColumns);
  EXPECT_TRUE(std::ranges::is_sorted(points, {}, &LidarPoint::t_ns));
  EXPECT_EQ(now.reader->read_lidar(now.lidar_files[1]).size(), std::size_t{kColumns});
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("revolutions of the same frame")));
}

// Times of today's clocks lose nanoseconds as seconds in a double.
TEST_F(DriveTest, AimotiveTimesAreExact) {
  constexpr std::int64_t kToday_ns = 1'369'730'762'904'519'681;
  const auto reader = std::make_shared<MadeReader>();
  for (FramePose& frame : recording_.frames) frame.t_ns += kToday_ns;
  reader->frames = recording_.frames;
  recording_.reader = reader;
  const Recording now = written(write_aimotive);
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("midnight")));
  EXPECT_LT(now.frames[0].t_ns, 86'400'000'000'000);
  EXPECT_EQ(now.frames[4].t_ns - now.frames[0].t_ns,
            recording_.frames[4].t_ns - recording_.frames[0].t_ns);
  EXPECT_EQ((recording_.frames[0].t_ns - now.frames[0].t_ns) % 86'400'000'000'000, 0);
  expect_same_rays(recording_, now, {0, 1});
  const LidarPoint point = now.reader->read_lidar(now.lidar_files[1])[9],
                   was = recording_.reader->read_lidar(recording_.lidar_files[1])[9];
  EXPECT_EQ(point.t_ns - now.frames[0].t_ns, was.t_ns - recording_.frames[0].t_ns);
}

TEST_F(DriveTest, Kitti360ComesBack) {
  recording_.cameras[1].calibration.parameters = {22, 20, 11.5, 7.5, 0, 0, 0, 0, 0};
  const Recording now = written(write_kitti360);
  EXPECT_EQ(now.format, "kitti360");
  EXPECT_TRUE(now.findings.empty()) << now.findings[0].what;
  ASSERT_EQ(now.cameras.size(), 2u);
  EXPECT_THAT(notes_.changed, Contains("FRONT is image_00"));
  EXPECT_THAT(notes_.changed, Contains("FISHEYE is image_02"));
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("not ECEF")));
  EXPECT_THAT(notes_.changed, Not(Contains(HasSubstr("mm off"))));
  expect_same_rays(recording_, now, {1, 0});
  for (std::size_t c = 0; c < 2; ++c) {
    const CameraCalibration &found = now.cameras[c].calibration,
                            &was = recording_.cameras[1 - c].calibration;
    EXPECT_EQ(found.parameters, was.parameters);
    EXPECT_EQ(found.width, was.width);
    EXPECT_EQ(found.time_offset_ns, was.time_offset_ns);
    EXPECT_EQ(read_image(now.cameras[c].images[3].path).rgb,
              read_image(recording_.cameras[1 - c].images[3].path).rgb);
  }
  for (std::size_t f = 0; f < 5; ++f) {
    EXPECT_EQ(now.frames[f].id, recording_.frames[f].id);
    EXPECT_EQ(now.frames[f].t_ns, recording_.frames[f].t_ns);
  }
}

TEST_F(DriveTest, Kitti360KeepsLidarPointsWhereTheyAre) {
  const Recording now = written(write_kitti360);
  ASSERT_EQ(now.lidar_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto points = now.reader->read_lidar(now.lidar_files[f]);
    auto were = recording_.reader->read_lidar(recording_.lidar_files[f]);
    for (LidarPoint& was : were) was.intensity *= 257;  // 8 bits become 16
    ASSERT_GT(points.size(), were.size() * 9 / 10);
    // Half of the frame's interval of 66.7 ms is the format's revolution, the scanner's has 100 ms.
    int moved = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      double off_m = 1;
      for (const LidarPoint& was : were)
        if (was.intensity == points[i].intensity)
          off_m = std::min(off_m,
                           (in_first_body(now, points[i]) - in_first_body(recording_, was)).norm());
      moved += off_m > 5e-6;                    // floats of 15 m step by 1e-6 m
      EXPECT_LT(off_m, 2e-3) << f << ' ' << i;  // at the border of two columns
    }
    EXPECT_LT(moved, kColumns / 20);
  }
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("ms off their own")));
}

TEST_F(DriveTest, Kitti360HasTheNearestRevolutionOfAFrame) {
  recording_.lidar_files.insert(recording_.lidar_files.begin() + 1,
                                {recording_.frames[1].id, "later"});
  const Recording now = written(write_kitti360);
  ASSERT_EQ(now.lidar_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f)
    EXPECT_LT(std::abs(*middle_ns(now.reader->read_lidar(now.lidar_files[f])) -
                       recording_.frames[f].t_ns),
              20'000'000)
        << f;
  EXPECT_THAT(notes_.left_out, Contains("1 LiDAR revolution of a frame to which another one is "
                                        "nearer"));
}

TEST_F(DriveTest, Kitti360LeavesOutRevolutionsOfOtherTimes) {
  const auto reader = std::make_shared<MadeReader>();
  reader->frames = recording_.frames;
  for (FramePose& frame : reader->frames) frame.t_ns += 1'000'000'000;
  recording_.reader = reader;
  recording_.box_files.clear();
  EXPECT_TRUE(written(write_kitti360).lidar_files.empty());
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("5 LiDAR revolutions without a pose")));
}

TEST_F(DriveTest, Kitti360KeepsObjects) {
  const Recording now = written(write_kitti360);
  ASSERT_EQ(now.box_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto boxes = now.reader->read_boxes(now.box_files[f]),
               were = recording_.reader->read_boxes(recording_.box_files[f]);
    ASSERT_EQ(boxes.size(), 3u) << f;
    for (const Box& was : were) {
      const auto found = std::ranges::min_element(boxes, {}, [&](const Box& box) {
        return (box.body_from_box.translation() - was.body_from_box.translation()).norm();
      });
      EXPECT_TRUE(found->body_from_box.isApprox(was.body_from_box, 1e-6)) << was.object_id;
      EXPECT_TRUE(found->size_m.isApprox(was.size_m, 1e-9));
      EXPECT_EQ(found->type, was.object_id == 9 ? "person" : "car");
      EXPECT_LT((found->velocity_in_body_m_per_s - was.velocity_in_body_m_per_s).norm(), 1e-4);
    }
  }
  EXPECT_THAT(notes_.changed, Contains("boxes of type CAR as car"));
}

TEST_F(DriveTest, Kitti360SaysWhatItCannotSay) {
  for (const char* name : {"REAR", "SIDE"}) {
    recording_.cameras.push_back(recording_.cameras[1]);
    recording_.cameras.back().calibration.name = name;
  }
  recording_.cameras.push_back(recording_.cameras[0]);
  recording_.cameras.back().calibration.name = "OTHER";
  recording_.cameras.back().calibration.parameters[8] = 0.01;
  recording_.cameras[1].calibration.readout_ns = 30'000'000;
  std::ranges::sort(recording_.cameras, {}, [](const auto& c) { return c.calibration.name; });
  const Recording now = written(write_kitti360);
  EXPECT_EQ(now.cameras.size(), 3u);
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("camera SIDE (opencv_pinhole)")));
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("camera OTHER (mei)")));
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("rolling shutter")));
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("resampled to a pinhole")));
}

// The lens of FRONT bends lines: its images are resampled to a pinhole that sees no border.
TEST_F(DriveTest, Kitti360ResamplesPinholesWithDistortion) {
  recording_.cameras[1].calibration.parameters[4] = 0.1;  // a pincushion
  const Recording now = written(write_kitti360);
  const CameraCalibration& pinhole = now.cameras[0].calibration;
  EXPECT_THAT(std::vector<double>(pinhole.parameters.begin() + 4, pinhole.parameters.end()),
              ::testing::Each(0));
  const Camera from = make_camera(recording_.cameras[1].calibration), to = make_camera(pinhole);
  const Image8 recorded = read_image(recording_.cameras[1].images[2].path),
               image = read_image(now.cameras[0].images[2].path);
  for (int y = 0; y < to.height; ++y)
    for (int x = 0; x < to.width; ++x) {
      const auto pixel = from.project(*to.unproject({double(x), double(y)}));
      ASSERT_TRUE(pixel);
      ASSERT_TRUE(pixel->x() > -0.01 && pixel->x() < from.width - 0.99) << x << ' ' << y;
      const auto i = 3 * static_cast<std::size_t>(y * to.width + x);
      EXPECT_NEAR(image.rgb[i], 5 * pixel->x(), 1.5);  // test_colour
      EXPECT_NEAR(image.rgb[i + 1], 7 * pixel->y(), 1.5);
    }
}

// Poses have the times of the first camera: between them the motion is linear.
TEST_F(DriveTest, Kitti360TellsHowFarPosesAreOff) {
  recording_.cameras[1].calibration.time_offset_ns = 20'000'000;
  written(write_kitti360);
  EXPECT_THAT(notes_.changed,
              Contains(HasSubstr("poses of image_02, interpolated from the first camera's")));
}

TEST_F(DriveTest, RefusesPhotographs) {
  recording_.metric = false;
  EXPECT_THROW(drive(), InputError);
}

}  // namespace
}  // namespace redrive
