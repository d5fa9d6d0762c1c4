// SPDX-License-Identifier: Apache-2.0
// Raw drives of KITTI, read back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/export/kitti/kitti_tracklets.h"
#include "redrive/export/made_drive_testing.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/formats/kitti/kitti_boxes.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::SizeIs;

class WriteKitti : public MadeDrive {
 protected:
  WriteKitti() { front().parameters = {22, 20, 11.5, 7.5, 0, 0, 0, 0, 0}; }
  CameraCalibration& front() { return recording_.cameras[1].calibration; }
  Recording written() {
    notes_ = write_kitti(out_, drive(), pool_, stop_);
    return open_recording(out_ / "1970_01_01/1970_01_01_drive_0000_sync");
  }
  /// Adds a camera beside FRONT, turned by an angle about its vertical axis, whose images are
  /// FRONT's.
  void add_camera(const std::string& name, double turned_rad) {
    recording_.cameras.push_back(recording_.cameras[1]);
    CameraCalibration& camera = recording_.cameras.back().calibration;
    camera.name = name;
    camera.body_from_sensor.translation().y() -= 0.5;
    camera.body_from_sensor.rotate(Eigen::AngleAxisd(turned_rad, Eigen::Vector3d::UnitY()));
  }
};

TEST_F(WriteKitti, ComesBack) {
  add_camera("RIGHT", 0);
  const Recording now = written();
  EXPECT_EQ(now.format, "kitti");
  EXPECT_THAT(now.findings, SizeIs(0)) << now.findings[0].what;
  EXPECT_THAT(notes_.changed, AllOf(Contains("FRONT is image_02"), Contains("RIGHT is image_03")));
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("camera FISHEYE (mei)")));
  ASSERT_EQ(now.cameras.size(), 2u);
  const Scene before = make_scene(recording_, {}), after = make_scene(now, {});
  ASSERT_EQ(after.views.size(), 10u);
  for (std::size_t c = 0; c < 2; ++c) {
    const RecordedCamera& was = recording_.cameras[1 + c];
    EXPECT_EQ(now.cameras[c].calibration.parameters, was.calibration.parameters);
    EXPECT_EQ(read_file(now.cameras[c].images[3].path), read_file(was.images[3].path));
  }
  for (std::size_t v = 0; v < after.views.size(); ++v) {
    const Rigid3d now_from_was = after.world_from_camera(after.views[v]).inverse() *
                                 before.world_from_camera(before.views[5 + v]);
    EXPECT_TRUE(now_from_was.isApprox(Rigid3d::Identity(), 1e-6)) << now_from_was.matrix();
  }
  for (std::size_t f = 0; f < 5; ++f) {
    EXPECT_EQ(now.frames[f].id, std::int64_t(f));
    EXPECT_EQ(now.frames[f].t_ns, recording_.frames[f].t_ns);
  }
  const std::string packet = read_file(now.root / "oxts/data/0000000002.txt");
  EXPECT_EQ(std::ranges::count(packet, ' '), 29);
  const std::string calibration = read_file(now.root.parent_path() / "calib_cam_to_cam.txt");
  for (const std::string number : {"00", "01", "02", "03"})  // pykitti and the devkit ask for all
    for (const char* key : {"S_", "K_", "D_", "R_", "T_", "S_rect_", "R_rect_", "P_rect_"})
      EXPECT_THAT(calibration, HasSubstr("\n" + (key + number) + ":"));
}

TEST_F(WriteKitti, KeepsLidarPointsWhereTheyAre) {
  const Recording now = written();
  ASSERT_EQ(now.lidar_files.size(), 5u);
  const auto points = now.reader->read_lidar(now.lidar_files[2]),
             were = recording_.reader->read_lidar(recording_.lidar_files[2]);
  ASSERT_GT(points.size(), were.size() - 8);
  for (const LidarPoint& point : points) {
    const Eigen::Vector3d in_global =
        pose_at(now.frames, point.t_ns) * point.in_body_m.cast<double>();
    double nearest_m = 1;
    for (const LidarPoint& was : were)
      nearest_m = std::min(
          nearest_m,
          (pose_at(recording_.frames, was.t_ns) * was.in_body_m.cast<double>() - in_global).norm());
    EXPECT_LT(nearest_m, 2e-5);
  }
}

// Readers tell KITTI's beams by the order of a scan's points.
TEST_F(WriteKitti, OrdersPointsByRings) {
  reader_->has_ring = true;
  const Recording now = written();
  const std::string bytes = read_file(now.lidar_files[0].path);
  double before_rad = -1;
  for (std::size_t at = 0; at < bytes.size(); at += kitti::kScanRecordBytes) {
    const float x = little_endian<float>(bytes, at), y = little_endian<float>(bytes, at + 4);
    const double turn_rad = std::atan2(y, x) + (y < 0 ? 2 * M_PI : 0);
    EXPECT_GT(turn_rad, before_rad);
    before_rad = turn_rad;
  }
  EXPECT_GT(before_rad, 6);
}

TEST_F(WriteKitti, KeepsBoxes) {
  const Recording now = written();
  ASSERT_EQ(now.box_files.size(), 5u);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto boxes = now.reader->read_boxes(now.box_files[f]);
    const auto were = recording_.reader->read_boxes(recording_.box_files[f]);
    ASSERT_EQ(boxes.size(), 3u);
    for (std::size_t b = 0; b < 3; ++b) {
      // The box is where it is when the laser sees it.
      const Rigid3d expected = global_from_box_at(were[b], recording_.frames, boxes[b].t_ns),
                    found = pose_at(now.frames, boxes[b].t_ns) * boxes[b].body_from_box;
      EXPECT_LT((expected.translation() - found.translation()).norm(), 1e-4);
      EXPECT_LT((expected.linear() - found.linear()).norm(), 1e-6);
      EXPECT_EQ(boxes[b].type, b == 2 ? "Pedestrian" : "Car");
      EXPECT_TRUE(boxes[b].size_m.isApprox(were[b].size_m));
    }
  }
  EXPECT_THAT(notes_.changed, Contains("boxes of type CAR as Car"));
}

// Cameras that are turned a little are rectified: pixels show what the lens saw that way.
TEST_F(WriteKitti, RectifiesCamerasThatLookSlightlyAside) {
  constexpr double kTurned_rad = 0.02;
  add_camera("RIGHT", kTurned_rad);
  add_camera("SIDE", 1);
  const Recording now = written();
  ASSERT_EQ(now.cameras.size(), 2u);
  EXPECT_THAT(notes_.left_out,
              Contains(HasSubstr("camera SIDE: looks 57 degrees away from FRONT")));
  EXPECT_TRUE(now.cameras[1].calibration.body_from_sensor.linear().isApprox(
      now.cameras[0].calibration.body_from_sensor.linear(), 1e-9));
  const Camera from = make_camera(recording_.cameras[2].calibration),
               to = make_camera(now.cameras[1].calibration);
  const Image8 image = read_image(now.cameras[1].images[2].path);
  for (int y = 0; y < to.height; ++y)
    for (int x = 0; x < to.width; ++x) {
      const Eigen::Vector3d in_body = now.cameras[1].calibration.body_from_sensor.linear() *
                                      *to.unproject({double(x), double(y)});
      const auto pixel = from.project(
          recording_.cameras[2].calibration.body_from_sensor.linear().transpose() * in_body);
      ASSERT_TRUE(pixel);
      const auto i = 3 * static_cast<std::size_t>(y * to.width + x);
      EXPECT_NEAR(image.rgb[i], 5 * pixel->x(), 1.5);  // test_colour
    }
}

TEST_F(WriteKitti, PutsOtherDrivesOnTheEquator) {
  recording_.global_frame = GlobalFrame::kArbitrary;
  for (FramePose& frame : recording_.frames)
    frame.global_from_body.translation() -= Eigen::Vector3d(4081775.25, 1405467.5, 4679608.75);
  make_reader();
  const Recording now = written();
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("latitude 0 and longitude 0")));
  const Rigid3d moved = recording_.frames[0].global_from_body.inverse() *
                        recording_.frames[4].global_from_body,
                now_moved =
                    now.frames[0].global_from_body.inverse() * now.frames[4].global_from_body;
  EXPECT_TRUE(now_moved.isApprox(moved, 1e-8));
}

TEST(KittiTracklets, AreCutWhereFramesAreMissing) {
  std::vector<Label> labels;
  for (const std::int64_t frame : {3, 4, 7}) {
    Label label;
    label.frame_id = frame;
    label.object_id = 5;
    label.type = "Van";
    label.size_m = {4, 2, 1.5};
    label.sensor_from_box = Rigid3d(Eigen::Translation3d(double(frame), 1, 0)) *
                            Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized());
    labels.push_back(label);
  }
  const std::vector<Label> parsed =
      kitti::parse_tracklets(kitti::make_tracklets(labels), "tracklets");
  ASSERT_EQ(parsed.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(parsed[i].frame_id, labels[i].frame_id);
    EXPECT_EQ(parsed[i].object_id, i == 2 ? 1 : 0);
    EXPECT_TRUE(parsed[i].sensor_from_box.isApprox(labels[i].sensor_from_box, 1e-12));
  }
}

TEST(KittiTracklets, HaveTypesOfTheDataSet) {
  for (const auto& [type, expected] : {std::pair("vehicle.truck", "Truck"),
                                       {"CAR", "Car"},
                                       {"human.pedestrian.adult", "Pedestrian"},
                                       {"Person_sitting", "Person (sitting)"},
                                       {"BIKE", "Cyclist"},
                                       {"VAN", "Van"},
                                       {"traffic cone", "Misc"}})
    EXPECT_EQ(kitti::type_of(type), expected) << type;
}

}  // namespace
}  // namespace redrive
