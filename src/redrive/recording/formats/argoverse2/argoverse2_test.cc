// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/argoverse2/argoverse2.h"

#include "redrive/camera/camera.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/core/camera_choice.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/formats/argoverse2/argoverse2_testing.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using testing::Argoverse2Drive;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using testing::input_error;

class Argoverse2 : public ::testing::Test {
 protected:
  Argoverse2() { drive_.write(folder_); }

  Recording opened() const { return open_recording(folder_.path); }
  static auto says(const std::string& subject, const std::string& what) {
    return Contains(
        AllOf(Field(&Finding::subject, subject), Field(&Finding::what, HasSubstr(what))));
  }
  static auto damaged(const std::string& sensor, const std::string& why) {
    return Contains(
        AllOf(Field(&DamagedRecord::sensor, sensor), Field(&DamagedRecord::why, HasSubstr(why))));
  }
  /// The error of opening the log with tables that `change` made wrong.
  std::string error_with(const std::function<void(Argoverse2Drive*)>& change) const {
    Argoverse2Drive drive;
    change(&drive);
    drive.write_tables(folder_);
    const std::string error = input_error([&] { opened(); });
    drive_.write_tables(folder_);
    return error;
  }

  TemporaryFolder folder_;
  Argoverse2Drive drive_;
};

TEST_F(Argoverse2, ReadsFramesAndCameras) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "argoverse2");
  ASSERT_EQ(recording.frames.size(), 8u);
  ASSERT_EQ(recording.cameras.size(), 9u);
  for (std::size_t f = 0; f < 8; ++f) {
    const FramePose& frame = recording.frames[f];
    EXPECT_EQ(frame.id, std::int64_t(f));
    EXPECT_EQ(frame.t_ns, Argoverse2Drive::t_ns(int(f)));
    EXPECT_TRUE(
        frame.global_from_body.isApprox(Argoverse2Drive::world_from_body(frame.t_ns), 1e-9));
  }
  for (const RecordedCamera& camera : recording.cameras) {
    const CameraCalibration& calibration = camera.calibration;
    EXPECT_EQ(camera.images.size(), 8u);
    EXPECT_EQ(calibration.time_offset_ns, drive_.offsets_ns.at(calibration.name));
    EXPECT_EQ(calibration.width, calibration.name == "ring_front_center" ? 96 : 128);
    EXPECT_EQ(calibration.parameters[1], 97.25);
    EXPECT_EQ(calibration.parameters[4], 0) << "images are rectified: k1 does not apply";
  }
  EXPECT_THAT(grey_cameras(recording), ElementsAre("stereo_front_left", "stereo_front_right"));
}

TEST_F(Argoverse2, RaysAreTheImages) {
  const Recording recording = opened();
  for (const RecordedCamera& recorded : recording.cameras) {
    const CameraCalibration& calibration = recorded.calibration;
    const Camera camera = make_camera(calibration);
    for (const FramePose& frame : recording.frames) {
      const std::int64_t t_ns = frame.t_ns + drive_.offsets_ns.at(calibration.name);
      const Rigid3d truth = Argoverse2Drive::world_from_vehicle(t_ns) *
                            drive_.vehicle_from(calibration.name),
                    read = pose_at(recording.frames, frame.t_ns + calibration.time_offset_ns) *
                           calibration.body_from_sensor;
      for (const Eigen::Vector3d& in_camera :
           {Eigen::Vector3d(0, 0, 5), Eigen::Vector3d(2, 1, 5), Eigen::Vector3d(-12, 5, 30)}) {
        const auto expected = camera.project(in_camera),
                   found = camera.project(read.inverse() * (truth * in_camera));
        ASSERT_TRUE(expected && found);
        EXPECT_LT((*expected - *found).norm(), 1e-4) << calibration.name << frame.id;
      }
    }
  }
}

TEST_F(Argoverse2, ReturnsLieInTheWorldWhereTheFileHasThem) {
  const Recording recording = opened();
  ASSERT_EQ(recording.lidars.size(), 2u);
  ASSERT_EQ(recording.lidar_files.size(), 8u);
  EXPECT_EQ(recording.lidars[1].name, "down_lidar");
  EXPECT_EQ(recording.lidars[0].body_from_lidar.translation(),
            Eigen::Vector3d(1.35, 0, 1.64 + 0.33));
  for (const FrameFile& file : recording.lidar_files) {
    const auto s = static_cast<std::size_t>(&file - recording.lidar_files.data()) % 4;
    EXPECT_EQ(file.frame_id, std::int64_t(2 * s + 1)) << "of their middles";
    EXPECT_EQ(recording.reader->lidar_point_count(file), 120u) << "at most";
    const std::int64_t scan_ns = Argoverse2Drive::scan_ns(int(s));
    std::vector<Argoverse2Drive::Point> truth = Argoverse2Drive::points(int(s));
    std::erase_if(truth,
                  [&](const auto& point) { return (point.laser >= 32) != (file.lidar == 1); });
    EXPECT_LT(truth.size(), 120u);
    std::ranges::stable_sort(truth, {}, &Argoverse2Drive::Point::offset_ns);
    const std::vector<LidarPoint> points = recording.reader->read_lidar(file);
    ASSERT_EQ(points.size(), truth.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_EQ(points[i].t_ns, scan_ns + truth[i].offset_ns);
      EXPECT_EQ(points[i].intensity, truth[i].intensity);
      EXPECT_EQ(points[i].ring, truth[i].laser % 32);
      const Eigen::Vector3d in_world =
          Argoverse2Drive::world_from_vehicle(scan_ns) * truth[i].in_vehicle;
      EXPECT_LT((pose_at(recording.frames, points[i].t_ns) * points[i].in_body_m.cast<double>() -
                 in_world)
                    .norm(),
                1e-6);
      EXPECT_LT((Argoverse2Drive::world_from_body(points[i].t_ns).inverse() * in_world -
                 points[i].in_body_m.cast<double>())
                    .norm(),
                1e-6);
    }
  }
}

TEST_F(Argoverse2, BoxesHoldBetweenThePassesOfBothLidars) {
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 4u);
  for (std::size_t s = 0; s < 4; ++s) {
    EXPECT_EQ(recording.box_files[s].frame_id, recording.lidar_files[s].frame_id);
    const std::int64_t scan_ns = Argoverse2Drive::scan_ns(int(s));
    const std::vector<Box> boxes = recording.reader->read_boxes(recording.box_files[s]);
    ASSERT_EQ(boxes.size(), 4u);
    for (const Box& box : boxes) {
      const auto row = std::ranges::find_if(drive_.annotations, [&](const auto& other) {
        return other.t_ns == scan_ns && (other.size - box.size_m).norm() < 1e-9;
      });
      ASSERT_NE(row, drive_.annotations.end());
      const Rigid3d truth =
          Argoverse2Drive::world_from_vehicle(scan_ns) * Argoverse2Drive::pose_of(*row);
      EXPECT_TRUE((pose_at(recording.frames, box.t_ns) * box.body_from_box).isApprox(truth, 1e-9));
      // One of the LiDARs passes a quarter of a revolution before, the other as much after.
      const double azimuth = std::atan2(row->at.y(), row->at.x() - 1.35),
                   up_at_box_time =
                       Argoverse2Drive::kUpAtFirst_rad -
                       Argoverse2Drive::kTurn_rad * double(box.t_ns - scan_ns - 2'654'000) / 1e8;
      EXPECT_NEAR(std::abs(std::sin(azimuth - up_at_box_time)), 1, 0.02) << row->name;
      EXPECT_GE(box.t_ns - scan_ns, 27'000'000);
      EXPECT_LE(box.t_ns - scan_ns, 79'000'000);
      const bool person = row->name == "bike";
      EXPECT_STREQ(kind_of(box.type).name, person ? "person" : "vehicle") << box.type;
      const Eigen::Vector3d velocity =
          pose_at(recording.frames, box.t_ns).linear() * box.velocity_in_body_m_per_s +
          velocity_at(recording.frames, box.t_ns);
      EXPECT_NEAR(velocity.y(), row->name == "car" ? 4 : 0, 0.2) << row->name;
    }
  }
}

TEST(Argoverse2Categories, LiveOrDoNot) {
  for (const char* category : {"PEDESTRIAN", "BICYCLIST", "MOTORCYCLIST", "WHEELED_RIDER", "DOG",
                               "OFFICIAL_SIGNALER", "STROLLER", "WHEELCHAIR", "ANIMAL"})
    EXPECT_STREQ(kind_of(category).name, "person") << category;
  for (const char* category : {"REGULAR_VEHICLE", "BICYCLE", "WHEELED_DEVICE", "STOP_SIGN"})
    EXPECT_STREQ(kind_of(category).name, "vehicle") << category;
  EXPECT_TRUE(argoverse2::is_known_category("BUS"));
  EXPECT_FALSE(argoverse2::is_known_category("SPACESHIP"));
}

TEST_F(Argoverse2, AnExcerptMayHaveLittle) {
  const fs::path cameras = folder_.path / "sensors/cameras";
  for (const char* name : {"stereo_front_left", "stereo_front_right", "ring_rear_left"})
    fs::remove_all(cameras / name);
  fs::remove(
      cameras / "ring_side_left" /
      (std::to_string(Argoverse2Drive::t_ns(3) + drive_.offsets_ns.at("ring_side_left")) + ".jpg"));
  fs::remove(folder_.path / "annotations.feather");
  fs::create_directories(cameras / "ring_of_fire");
  Recording recording = opened();
  EXPECT_EQ(recording.cameras.size(), 6u);
  EXPECT_EQ(recording.find_camera("ring_side_left")->images.size(), 7u);
  EXPECT_EQ(recording.find_camera("ring_side_left")->calibration.time_offset_ns,
            drive_.offsets_ns.at("ring_side_left"));
  EXPECT_THAT(recording.findings, says("cameras", "3 cameras of the calibration without images"));
  EXPECT_THAT(recording.findings, says("ring_of_fire", "left out: no row of"));
  EXPECT_THAT(recording.findings, says("boxes", "annotations.feather is missing"));

  fs::remove_all(cameras / "ring_front_center");
  recording = opened();
  EXPECT_EQ(recording.frames.size(), 9u) << "cameras that fire 25 ms later belong to the next";
  fs::remove_all(folder_.path / "sensors/lidar");
  EXPECT_TRUE(opened().lidar_files.empty());
  fs::remove_all(cameras);
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("sensors/cameras: has no image"));
}

TEST_F(Argoverse2, ImagesAndScansFarFromTheOthers) {
  const std::string late = std::to_string(Argoverse2Drive::t_ns(8) + 5'000'000'000);
  fs::copy(folder_.path / "sensors/cameras/ring_front_left" /
               (std::to_string(Argoverse2Drive::t_ns(0) + drive_.offsets_ns.at("ring_front_left")) +
                ".jpg"),
           folder_.path / "sensors/cameras/ring_front_left" / (late + ".jpg"));
  Argoverse2Drive::write_scan(folder_, 90, Argoverse2Drive::points(0));
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 8u);
  EXPECT_THAT(recording.findings, says("ring_front_left", "1 image dropped"));
  EXPECT_EQ(recording.lidar_files.size(), 8u);
  EXPECT_THAT(recording.findings, says("lidar", "1 scan not used: no image within 0.1 s"));
}

TEST_F(Argoverse2, ATwinOfAnImageCostsItself) {
  const fs::path folder = folder_.path / "sensors/cameras/ring_front_center";
  fs::copy(folder / (std::to_string(Argoverse2Drive::t_ns(2)) + ".jpg"),
           folder / (std::to_string(Argoverse2Drive::t_ns(2) + 3) + ".jpg"));
  const Recording recording = opened();
  EXPECT_EQ(recording.find_camera("ring_front_center")->images.size(), 8u);
  EXPECT_THAT(recording.damaged, damaged("times of ring_front_center", "less than 5 ms after"));
}

TEST_F(Argoverse2, ARowThatIsNoPoseCostsItself) {
  drive_.poses[5].wxyz.setZero();
  drive_.poses[9].at.x() = std::nan("");
  drive_.poses[20].at.y() += 500;
  drive_.poses[30].t_ns = -1;
  drive_.write_tables(folder_);
  const Recording recording = opened();
  EXPECT_THAT(recording.damaged, damaged("poses", "qw, qx, qy, qz of row 5"));
  EXPECT_THAT(recording.damaged, damaged("poses", "tx_m of row 9 = nan"));
  EXPECT_THAT(recording.damaged, damaged("poses", "no car moves so to the poses around it"));
  EXPECT_THAT(recording.damaged, damaged("poses", "timestamp_ns of row 30 = -1"));
  for (const FramePose& frame : recording.frames)
    EXPECT_TRUE(
        frame.global_from_body.isApprox(Argoverse2Drive::world_from_body(frame.t_ns), 1e-9));
}

TEST_F(Argoverse2, NamesFileFieldAndValue) {
  EXPECT_THAT(error_with([](auto* drive) { drive->poses.clear(); }),
              HasSubstr("city_SE3_egovehicle.feather: has no pose"));
  EXPECT_THAT(error_with([](auto* drive) { drive->extrinsics[2].wxyz.setZero(); }),
              AllOf(HasSubstr("egovehicle_SE3_sensor.feather: qw, qx, qy, qz of row 2"),
                    HasSubstr("must be a quaternion")));
  EXPECT_THAT(error_with([](auto* drive) { drive->extrinsics[2].name = "ring_front_center"; }),
              HasSubstr("sensor_name of row 2 = ring_front_center: there are two"));
  EXPECT_THAT(error_with([](auto* drive) { drive->intrinsics[1].fx = 0; }),
              HasSubstr("intrinsics.feather: fx_px of row 1 = 0.000000: pixels, above 0"));
  EXPECT_THAT(error_with([](auto* drive) { drive->intrinsics[3].cy = 1e4; }),
              HasSubstr("cy_px of row 3 = 10000.000000"));
  EXPECT_THAT(error_with([](auto* drive) { drive->intrinsics[0].width = 0; }),
              HasSubstr("width_px of row 0 = 0.000000"));
  EXPECT_THAT(error_with([](auto* drive) { drive->intrinsics[1].name = "ring_front_center"; }),
              HasSubstr("there are two such cameras"));
  for (const char* file :
       {"city_SE3_egovehicle.feather", "annotations.feather", "calibration/intrinsics.feather",
        "calibration/egovehicle_SE3_sensor.feather"}) {
    folder_.write(file, "no table");
    EXPECT_THAT(input_error([&] { opened(); }),
                AllOf(HasSubstr(file), HasSubstr("is no Arrow file")));
    drive_.write_tables(folder_);
  }
}

TEST_F(Argoverse2, ALidarWithoutAPlaceCostsItself) {
  std::erase_if(drive_.extrinsics, [](const auto& row) { return row.name == "up_lidar"; });
  drive_.write_tables(folder_);
  Recording recording = opened();
  ASSERT_EQ(recording.lidars.size(), 1u);
  EXPECT_EQ(recording.lidars[0].name, "down_lidar");
  EXPECT_EQ(recording.lidar_files.size(), 4u);
  const auto lasers = [&] {
    std::size_t up = 0;
    for (const auto& point : Argoverse2Drive::points(0)) up += point.laser < 32;
    return 120 - up;
  };
  EXPECT_EQ(recording.reader->read_lidar(recording.lidar_files[0]).size(), lasers());
  EXPECT_THAT(recording.findings, says("up_lidar", "its returns are not used: no row of"));
  std::erase_if(drive_.extrinsics, [](const auto& row) { return row.name == "down_lidar"; });
  drive_.write_tables(folder_);
  recording = opened();
  EXPECT_TRUE(recording.lidar_files.empty());
  EXPECT_EQ(recording.box_files.size(), 4u) << "boxes hold in the middle of the scan";
}

TEST_F(Argoverse2, ScansCountWhatCannotBe) {
  std::vector<Argoverse2Drive::Point> points = Argoverse2Drive::points(1);
  points[0].in_vehicle.x() = std::nan("");
  points[1].laser = 64;
  Argoverse2Drive::write_scan(folder_, 1, points);
  const Recording recording = opened();
  std::size_t left_out = 0;
  const std::size_t up = recording.reader->read_lidar(recording.lidar_files[1], &left_out).size();
  EXPECT_EQ(up + recording.reader->read_lidar(recording.lidar_files[5]).size(), 118u);
  EXPECT_EQ(left_out, 2u);
  for (std::size_t i = 0; i < 10; ++i) points[10 + i].in_vehicle.y() = 5000;
  Argoverse2Drive::write_scan(folder_, 1, points);
  EXPECT_THAT(input_error([&] { recording.reader->read_lidar(recording.lidar_files[1]); }),
              AllOf(HasSubstr(".feather: y of row 1"), HasSubstr("at most 1000 m away")));
  const std::string scan = "sensors/lidar/" + std::to_string(Argoverse2Drive::scan_ns(1));
  folder_.write(scan + ".feather", "no table");
  EXPECT_THAT(input_error([&] { recording.reader->read_lidar(recording.lidar_files[1]); }),
              HasSubstr("is no Arrow file"));
  EXPECT_EQ(recording.reader->lidar_point_count(recording.lidar_files[1]), 0u);
}

TEST_F(Argoverse2, ACuboidThatCannotBeCostsItself) {
  drive_.annotations[1].size.y() = 0;
  drive_.annotations[2].category = "SPACESHIP";
  drive_.write_tables(folder_);
  const Recording recording = opened();
  EXPECT_EQ(recording.reader->read_boxes(recording.box_files[0]).size(), 3u);
  EXPECT_THAT(recording.findings, says("boxes", "1 cuboid without a size, a place or a name"));
  EXPECT_THAT(recording.findings, says("boxes", "width_m of row 1 = 0.000000"));
  EXPECT_THAT(recording.findings,
              says("boxes", "1 cuboid of categories that Argoverse 2 does not list"));
  EXPECT_THAT(recording.findings, says("boxes", "vehicles: SPACESHIP"));
}

}  // namespace
}  // namespace redrive
