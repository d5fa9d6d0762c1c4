// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/waymo/waymo.h"

#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/waymo/waymo_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using testing::input_error;
using testing::MadeSegment;

class Waymo : public ::testing::Test {
 protected:
  Recording opened() const {
    made_.write(file_);
    return open_recording(folder_.path);
  }
  std::string error() const {
    return input_error([&] { opened(); });
  }
  static auto says(const std::string& subject, const std::string& what) {
    return Contains(
        AllOf(Field(&Finding::subject, subject), Field(&Finding::what, HasSubstr(what))));
  }
  static auto damaged(const std::string& sensor, const std::string& why) {
    return Contains(
        AllOf(Field(&DamagedRecord::sensor, sensor), Field(&DamagedRecord::why, HasSubstr(why))));
  }
  static double seconds(std::int64_t t_ns) {
    return 1e-9 * static_cast<double>(t_ns - 1000 * MadeSegment::kFirst_us);
  }

  TemporaryFolder folder_;
  MadeSegment made_;
  const std::filesystem::path file_ = folder_.path / "segment-1.tfrecord";
};

constexpr double kDoubleTime_m = 1e-5;  // seconds since 1970 as a double step by 0.24 us

TEST_F(Waymo, FramesAndCameras) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "waymo");
  ASSERT_EQ(recording.frames.size(), 6u);
  ASSERT_EQ(recording.cameras.size(), 2u);
  EXPECT_THAT(recording.findings, says("boxes", "1 frame with no-label zones"));
  for (const RecordedCamera& camera : recording.cameras) {
    const CameraCalibration& calibration = camera.calibration;
    const bool front = calibration.name == "FRONT";
    EXPECT_NEAR(double(calibration.readout_ns), front ? 3e7 : -3e7, 1000);
    EXPECT_EQ(calibration.readout_by_column, !front);
    EXPECT_NEAR(double(calibration.time_offset_ns), front ? 0 : -2e7, 1000);
    ASSERT_EQ(camera.images.size(), 6u);
    for (int f = 0; f < 6; ++f) {
      const ImageFile& image = camera.images[static_cast<std::size_t>(f)];
      const FramePose& frame = recording.frames[static_cast<std::size_t>(f)];
      EXPECT_EQ(image.frame_id, frame.id);
      const double middle_s =
          MadeSegment::frame_s(f) + (front ? MadeSegment::kFront_s : MadeSegment::kLeft_s);
      const std::int64_t t_ns = frame.t_ns + calibration.time_offset_ns;
      EXPECT_NEAR(seconds(t_ns), middle_s, 1e-6);
      EXPECT_LT((pose_at(recording.frames, t_ns).translation() -
                 MadeSegment::world_from_body(middle_s).translation())
                    .norm(),
                kDoubleTime_m);
      EXPECT_NEAR(read_image(image.path).rgb[0], 40 + 20 * f, 2);
    }
    // The camera looks along the body's x axis; a pixel counts from the corner.
    const Camera lens = make_camera(calibration);
    const Eigen::Vector3d ahead = calibration.body_from_sensor.linear() * Eigen::Vector3d(0, 0, 1);
    EXPECT_LT((ahead - Eigen::Vector3d::UnitX()).norm(), 1e-12);
    EXPECT_LT((*lens.project({0, 0, 1}) - Eigen::Vector2d(32, 23.5)).norm(), 1e-9);
    const double x = 0.2, y = -0.1, rr = x * x + y * y,
                 scale = 1 + rr * (0.05 + rr * (-0.01 + rr * 0.003));
    EXPECT_LT((*lens.project({x, y, 1}) -
               Eigen::Vector2d(50 * (x * scale + 2 * 0.001 * x * y - 0.002 * (rr + 2 * x * x)) + 32,
                               51 * (y * scale + 0.001 * (rr + 2 * y * y) - 0.004 * x * y) + 23.5))
                  .norm(),
              1e-6);
  }
}

TEST_F(Waymo, ScansOfTheRoof) {
  const Recording recording = opened();
  ASSERT_EQ(recording.lidars.size(), 2u);
  EXPECT_THAT(recording.findings, says("lidar", "first return"));
  const std::vector<FrameFile> scans = recording.scans_of(0);
  ASSERT_EQ(scans.size(), 6u);
  for (int f = 0; f < 6; ++f) {
    std::size_t left_out = 0;
    const auto points = recording.read_lidar(scans[static_cast<std::size_t>(f)], &left_out);
    auto point = points.begin();
    for (int column = 0; column < MadeSegment::kColumns; ++column)
      for (int row = 0; row < MadeSegment::kRows; ++row) {
        if (MadeSegment::is_lost(row, column)) continue;
        ASSERT_NE(point, points.end());
        // Poses of pixels are floats, a kilometre from their origin.
        EXPECT_NEAR(seconds(point->t_ns), MadeSegment::column_s(f, column), 1e-5);
        EXPECT_LT((point->in_body_m.cast<double>() - MadeSegment::in_body(row, column)).norm(),
                  2e-4);
        EXPECT_EQ(point->ring, row);
        EXPECT_EQ(point->intensity, std::lround(65535 * std::tanh(0.01f * float(column))));
        ++point;
      }
    EXPECT_EQ(point, points.end());
    EXPECT_EQ(left_out, 0u) << "lost rays are no damage";
  }
}

TEST_F(Waymo, OtherScansAreAtTheirFramesTime) {
  const Recording recording = opened();
  EXPECT_EQ(recording.lidars[1].name, "FRONT_LASER");
  const auto points = recording.read_lidar(recording.scans_of(1)[3]);
  ASSERT_EQ(points.size(), 12u);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const int column = static_cast<int>(i / 2), row = static_cast<int>(i % 2);
    const Eigen::Vector3d expected =
        MadeSegment::body_from_front_laser() *
        (3.0 *
         beam_direction(row == 0 ? 0.25 : -0.25, MadeSegment::azimuth_in_body_rad(column, 6)));
    EXPECT_LT((points[i].in_body_m.cast<double>() - expected).norm(), 1e-5);
    EXPECT_NEAR(seconds(points[i].t_ns), MadeSegment::frame_s(3), 1e-9);
  }
}

// A car that stands has no way along which times are found.
TEST_F(Waymo, ScansOfACarThatStands) {
  for (auto& frame : made_.frames) {
    const auto stand = [](waymo_testing::Transform* pose) {
      pose->Clear();
      MadeSegment::set(MadeSegment::world_from_body(0), pose);
    };
    stand(frame.mutable_pose());
    for (auto& image : *frame.mutable_images()) stand(image.mutable_pose());
    std::vector<float> poses;
    for (int i = 0; i < MadeSegment::kRows * MadeSegment::kColumns; ++i)
      poses.insert(poses.end(), {0, 0, 0.5f, 1000, -500, 20});
    frame.mutable_lasers(0)->mutable_ri_return1()->set_range_image_pose_compressed(
        MadeSegment::packed_matrix(poses, {MadeSegment::kRows, MadeSegment::kColumns, 6}));
  }
  const Recording recording = opened();
  for (const LidarPoint& point : recording.read_lidar(recording.scans_of(0)[1])) {
    const double column =
        (seconds(point.t_ns) - MadeSegment::frame_s(1)) / 0.1 * MadeSegment::kColumns - 0.5;
    EXPECT_NEAR(column, std::round(column), 1e-3);
  }
}

TEST_F(Waymo, BoxesMoveInTheWorld) {
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 6u);
  for (int f = 0; f < 6; ++f) {
    const auto boxes = recording.reader->read_boxes(recording.box_files[std::size_t(f)]);
    ASSERT_EQ(boxes.size(), 1u);
    const Box& box = boxes[0];
    EXPECT_EQ(box.type, "VEHICLE");
    EXPECT_EQ(box.size_m, Eigen::Vector3d(4.5, 1.75, 1.5));
    EXPECT_NEAR(seconds(box.t_ns), MadeSegment::frame_s(f), 1e-9);
    const Rigid3d world_from_box = pose_at(recording.frames, box.t_ns) * box.body_from_box;
    EXPECT_LT((world_from_box.translation() -
               Eigen::Vector3d(1015 + 12 * MadeSegment::frame_s(f), -497, 20.8))
                  .norm(),
              kDoubleTime_m);
    EXPECT_LT((world_from_box.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-5);
  }
}

TEST_F(Waymo, AFileIsARecordingToo) {
  made_.write(file_);
  EXPECT_EQ(open_recording(file_).cameras.size(), 2u);
  std::filesystem::copy(file_, folder_.path / "segment-2.tfrecord");
  EXPECT_THAT(input_error([&] { open_recording(folder_.path); }), HasSubstr("has 2 segments"));
}

TEST_F(Waymo, DamageCostsItsRecord) {
  made_.frames[1].mutable_images(0)->clear_pose_timestamp();
  made_.frames[2].clear_pose();
  made_.frames[4].mutable_laser_labels(0)->mutable_box()->set_height(-1);
  auto* first = made_.frames[3].mutable_lasers(0)->mutable_ri_return1();
  first->set_range_image_compressed(first->range_image_compressed().substr(0, 50));
  const Recording recording = opened();
  EXPECT_EQ(recording.find_camera("FRONT")->images.size(), 4u);
  EXPECT_EQ(recording.find_camera("SIDE_LEFT")->images.size(), 5u);
  EXPECT_THAT(recording.damaged, damaged("images", "image of FRONT: has no pose with a time"));
  EXPECT_THAT(recording.damaged, damaged("frames", "pose: is missing"));
  EXPECT_THAT(recording.findings, says("boxes", "box of car-1"));
  EXPECT_THAT(input_error([&] { recording.read_lidar(recording.scans_of(0)[2]); }),
              HasSubstr("range image of TOP: is damaged"));
}

TEST_F(Waymo, FilesThatAreCutOrOthers) {
  const std::string whole = made_.bytes();
  folder_.write("segment-1.tfrecord", whole.substr(0, whole.size() - 30));
  const Recording recording = open_recording(folder_.path);
  EXPECT_EQ(recording.frames.size(), 5u);
  EXPECT_THAT(recording.damaged, damaged("frames", "record 5: is cut off"));
  folder_.write("segment-1.tfrecord", "no records");
  EXPECT_THAT(input_error([&] { open_recording(folder_.path); }), HasSubstr("is no TFRecord file"));
  folder_.write("segment-1.tfrecord", "");
  EXPECT_THAT(input_error([&] { open_recording(folder_.path); }), HasSubstr("has no frame"));
}

TEST_F(Waymo, NamesWhatCannotBe) {
  made_.frames[1].mutable_context()->set_name("other");
  EXPECT_THAT(opened().damaged, damaged("frames", "other frames are of made"));
  made_ = {};
  made_.frames[0]
      .mutable_context()
      ->mutable_camera_calibrations(0)
      ->mutable_intrinsic()
      ->RemoveLast();
  const Recording recording = opened();
  EXPECT_THAT(recording.findings, says("camera_calibrations", "8 numbers: must be 9"));
  EXPECT_THAT(recording.findings, says("FRONT", "has no calibration"));
  EXPECT_EQ(recording.cameras.size(), 1u);
  made_ = {};
  made_.frames[0].mutable_context()->mutable_laser_calibrations(0)->add_beam_inclinations(0.1);
  const Recording other = opened();
  EXPECT_THAT(input_error([&] { other.read_lidar(other.scans_of(0)[0]); }),
              HasSubstr("has 4 rows, its calibration 5"));
}

}  // namespace
}  // namespace redrive
