// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti360/kitti360.h"

#include "redrive/base/files/files.h"
#include "redrive/camera/camera.h"
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"
#include "redrive/recording/formats/kitti360/kitti360_testing.h"
#include "redrive/recording/formats/pose_files.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;
using testing::kKitti360Drive;

class Kitti360 : public ::testing::Test {
 protected:
  Kitti360() { testing::write_kitti360_drive(folder_); }
  Recording opened() const { return open_recording(folder_.path); }
  /// Message of the InputError, or of what is left out as damaged, with one file changed, or
  /// removed where `text` is empty.
  std::string message(const fs::path& file, const std::string& text = "") const {
    const std::string before = read_file(folder_.path / file);
    fs::remove(folder_.path / file);
    if (!text.empty()) folder_.write(file, text);
    std::string what;
    try {
      what = opened().damaged.at(0).why;
    } catch (const InputError& error) {
      what = error.what();
    }
    folder_.write(file, before);
    return what;
  }
  std::string findings(const std::string& subject) const {
    std::string all;
    for (const Finding& finding : opened().findings)
      if (finding.subject == subject) all += finding.what + "\n";
    return all;
  }

  TemporaryFolder folder_;
  const fs::path images_ = fs::path("data_2d_raw") / kKitti360Drive,
                 scans_ = fs::path("data_3d_raw") / kKitti360Drive / "velodyne_points",
                 poses_ = fs::path("data_poses") / kKitti360Drive / "poses.txt",
                 boxes_ = fs::path("data_3d_bboxes/train") / (std::string(kKitti360Drive) + ".xml");
};

TEST_F(Kitti360, OpensADriveByEachOfItsFolders) {
  for (const fs::path& root : {folder_.path, folder_.path / images_, folder_.path / images_ / "",
                               folder_.path / scans_.parent_path()}) {
    const Recording recording = open_recording(root);
    EXPECT_EQ(recording.format, "kitti360");
    EXPECT_TRUE(recording.metric);
    ASSERT_EQ(recording.cameras.size(), 2u);
    EXPECT_EQ(recording.cameras[0].calibration.name, "image_00");
    EXPECT_EQ(recording.cameras[0].calibration.model, "opencv_pinhole");
    EXPECT_EQ(recording.cameras[1].calibration.name, "image_02");
    EXPECT_EQ(recording.cameras[1].calibration.model, "mei");
    EXPECT_THAT(
        recording.cameras[1].calibration.parameters,
        ElementsAre(1336, 1335.5, 716.9, 705.8, 1.6e-2, 1.65, 4e-4, 5e-4, 0, 2.2134047507854890));
    ASSERT_EQ(recording.cameras[1].images.size(), 3u);
    EXPECT_EQ(recording.frames.size(), 3u);
    EXPECT_EQ(recording.lidar_files.size(), 3u);
    EXPECT_TRUE(recording.findings.empty()) << recording.findings[0].what;
  }
  fs::create_directories(folder_.path / "data_2d_raw/2013_05_28_drive_0009_sync");
  EXPECT_THAT(input_error([&] { opened(); }),
              AllOf(HasSubstr("data_2d_raw"), HasSubstr("drive_0007_sync"), HasSubstr("0009")));
  EXPECT_EQ(open_recording(folder_.path / images_).cameras.size(), 2u);
}

// The IMU is 0.05 m behind the rear axle, 0.32 m to the left of the middle, 0.9 m above the road.
// Excerpts have all of a drive in its folder; velodyne_points does not make it one of KITTI.
TEST_F(Kitti360, OpensADriveThatStandsAlone) {
  const Recording whole = opened();
  const fs::path alone = folder_.path / "excerpt";
  fs::rename(folder_.path / images_, alone);
  fs::rename(folder_.path / scans_, alone / "velodyne_points");
  fs::rename(folder_.path / poses_, alone / "poses.txt");
  fs::rename(folder_.path / "calibration", alone / "calibration");
  const Recording recording = open_recording(alone);
  EXPECT_EQ(recording.format, "kitti360");
  EXPECT_EQ(recording.cameras.size(), 2u);
  EXPECT_EQ(recording.lidar_files.size(), 3u);
  EXPECT_EQ(recording.frames[1].global_from_body.matrix(),
            whole.frames[1].global_from_body.matrix());
  for (const char* file :
       {"calib_cam_to_pose.txt", "calib_cam_to_velo.txt", "perspective.txt", "image_02.yaml"})
    fs::rename(alone / "calibration" / file, alone / file);
  EXPECT_EQ(open_recording(alone).cameras.size(), 2u);
  fs::remove(alone / "poses.txt");
  EXPECT_THAT(input_error([&] { open_recording(alone); }), HasSubstr("poses.txt"));
}

TEST_F(Kitti360, ReadsCalibrationAndPosesInTheDrivesFolder) {
  fs::rename(folder_.path / poses_, folder_.path / images_ / "poses.txt");
  fs::rename(folder_.path / "calibration", folder_.path / images_ / "calibration");
  EXPECT_EQ(opened().frames.size(), 3u);
}

// A drive has poses to its end, the excerpt times of its own frames.
TEST_F(Kitti360, LeavesPosesBehindTheLastTimeOut) {
  folder_.write(poses_, read_file(folder_.path / poses_) + testing::kitti360_pose(70));
  EXPECT_EQ(opened().frames.size(), 3u);
  EXPECT_THAT(findings("timestamps.txt"), HasSubstr("no time for frame 70"));
}

TEST_F(Kitti360, TheBodyIsOnTheGroundBelowTheRearAxle) {
  const Recording recording = opened();
  const Rigid3d &front = recording.cameras[0].calibration.body_from_sensor,
                &left = recording.cameras[1].calibration.body_from_sensor;
  EXPECT_TRUE(front.translation().isApprox(Eigen::Vector3d(1.45, 0, 1.55), 1e-12));
  EXPECT_TRUE(front.linear().col(2).isApprox(Eigen::Vector3d::UnitX(), 1e-12));
  EXPECT_TRUE(front.linear().col(1).isApprox(-Eigen::Vector3d::UnitZ(), 1e-12));
  EXPECT_TRUE(left.translation().isApprox(Eigen::Vector3d(0.65, 0.47, 1.97), 1e-12));
  EXPECT_TRUE(left.linear().col(2).isApprox(Eigen::Vector3d::UnitY(), 1e-12));
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.translation().isApprox(
      Eigen::Vector3d(0.65, 0, 1.75), 1e-12));
  for (const FramePose& frame : recording.frames) {
    EXPECT_NEAR(frame.global_from_body.translation().z(), 0, 1e-12);
    EXPECT_TRUE(frame.global_from_body.linear().isIdentity(1e-12)) << "x forward, z up";
  }
}

TEST_F(Kitti360, RectificationTurnsTheCamera) {
  std::string text = testing::kitti360_perspective();
  const std::string identity = "R_rect_00: 1 0 0 0 1 0 0 0 1";
  text.replace(text.find(identity), identity.size(), "R_rect_00: 0.8 0 -0.6 0 1 0 0.6 0 0.8");
  folder_.write("calibration/perspective.txt", text);
  const Rigid3d front = opened().cameras[0].calibration.body_from_sensor;
  // The rectified axis z is (0.6, 0, 0.8) in the camera: ahead and to the right.
  EXPECT_TRUE(front.linear().col(2).isApprox(Eigen::Vector3d(0.8, -0.6, 0), 1e-12));
}

TEST_F(Kitti360, TimesAreThoseOfEachSensor) {
  const Recording recording = opened();
  EXPECT_EQ(recording.frames[0].t_ns % 1'000'000'000, 200'000'000);
  EXPECT_EQ(recording.cameras[0].calibration.time_offset_ns, 0);
  EXPECT_EQ(recording.cameras[1].calibration.time_offset_ns, 3'000'000);
  const std::vector<LidarPoint> points = recording.reader->read_lidar(recording.lidar_files[0]);
  ASSERT_EQ(points.size(), 2u);
  const std::int64_t ahead_ns = recording.frames[0].t_ns - 10'000'000;
  EXPECT_NEAR(static_cast<double>(points[1].t_ns - ahead_ns), 0, 25e3);
  EXPECT_NEAR(static_cast<double>(points[0].t_ns - ahead_ns), -25e6, 25e3) << "left comes first";
  EXPECT_LT((points[1].in_body_m - Eigen::Vector3f(10.65f, 0, 1.75f)).norm(), 1e-5);
}

TEST_F(Kitti360, LeavesFramesWithoutAPoseOut) {
  folder_.write(poses_, testing::kitti360_pose(2) + testing::kitti360_pose(4));
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 2u);
  EXPECT_EQ(recording.cameras[0].images.size(), 2u);
  EXPECT_EQ(recording.lidar_files.size(), 2u);
  EXPECT_THAT(findings("image_00"), HasSubstr("no pose for frame 3"));
  EXPECT_THAT(findings("velodyne_points"), HasSubstr("no pose for the scan of frame 3"));
}

TEST_F(Kitti360, ReadsPosesOfTheFirstCamera) {
  const std::vector<FramePose> frames = opened().frames;
  std::string cameras, moved;
  for (const FramePose& frame : frames) {
    const std::string x = std::to_string(frame.id + 1.5);
    cameras += std::to_string(frame.id) + " 0 0 1 " + x + " -1 0 0 -0.32 0 -1 0 1.55 0 0 0 1\n";
    moved += std::to_string(frame.id) + " 0 0 1 " + x + " -1 0 0 -0.82 0 -1 0 1.55 0 0 0 1\n";
  }
  const fs::path camera_file = poses_.parent_path() / "cam0_to_world.txt";
  folder_.write(camera_file, moved);
  EXPECT_THAT(findings("cam0_to_world.txt"), HasSubstr("0.500 m away from poses.txt"));
  folder_.write(camera_file, cameras);
  EXPECT_EQ(findings("cam0_to_world.txt"), "");
  fs::remove(folder_.path / poses_);
  const std::vector<FramePose> same = opened().frames;
  for (std::size_t i = 0; i < frames.size(); ++i)
    EXPECT_TRUE(same[i].global_from_body.isApprox(frames[i].global_from_body, 1e-9));
  cameras.replace(cameras.find("3 0 0 1 4"), 9, "3 0 0 1 104");
  folder_.write(camera_file, cameras);
  EXPECT_THAT(opened().damaged.at(0).why,
              AllOf(HasSubstr("cam0_to_world.txt: 3.pose"), HasSubstr("101.00 m")));
}

kitti360::Object made_object(std::int64_t id, const std::string& type, std::int64_t frame,
                             double x) {
  kitti360::Object object;
  object.id = id, object.type = type, object.frame_id = frame;
  object.first_frame = 2, object.last_frame = 3;
  object.world_from_box =
      Eigen::Translation3d(x, 4, 0.8) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ());
  object.size_m = {4.5, 1.8, 1.6};
  return object;
}

TEST(Kitti360Classes, AreFoundByNamesOfOtherDataSets) {
  const auto class_of = [](const char* name) { return kitti360::class_named(name).name; };
  EXPECT_EQ(class_of("Van"), "car");
  EXPECT_EQ(class_of("vehicle.car"), "car");
  EXPECT_EQ(class_of("vehicle.bus.rigid"), "bus");
  EXPECT_EQ(class_of("vehicle.bicycle"), "bicycle");
  EXPECT_EQ(class_of("human.pedestrian.adult"), "person");
  EXPECT_EQ(class_of("animal"), "person");
  EXPECT_EQ(class_of("scooter"), "unknown vehicle");
}

TEST_F(Kitti360, ReadsObjectsThatMoveAndThatStand) {
  folder_.write(boxes_, kitti360::make_objects(
                            {made_object(26001, "car", 2, 20), made_object(26001, "car", 3, 21.5),
                             made_object(26001, "car", 5, 24.5),
                             made_object(26002, "Van", kitti360::kStatic, 12),
                             made_object(26003, "car", kitti360::kStatic, 500),
                             made_object(24001, "person", kitti360::kStatic, 8)}));
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 3u);
  const std::vector<Box> boxes = recording.reader->read_boxes(recording.box_files[1]);
  ASSERT_EQ(boxes.size(), 3u) << "the car at 500 m is too far away";
  const Box &moving = boxes[0], &person = boxes[1], &parked = boxes[2];
  EXPECT_EQ(moving.object_id, 26001);
  EXPECT_EQ(moving.type, "car");
  EXPECT_EQ(moving.t_ns, recording.frames[1].t_ns);
  EXPECT_TRUE(moving.size_m.isApprox(Eigen::Vector3d(4.5, 1.8, 1.6), 1e-9));
  // The body of frame 3 is at (3.05, -0.32, 0).
  EXPECT_TRUE(moving.body_from_box.translation().isApprox(Eigen::Vector3d(18.45, 4.32, 0.8), 1e-9));
  EXPECT_NEAR(moving.body_from_box.linear()(0, 0), std::cos(0.3), 1e-9);
  EXPECT_TRUE(moving.velocity_in_body_m_per_s.isApprox(Eigen::Vector3d(5, 0, 0), 1e-6))
      << "15 m/s, minus our 10";
  EXPECT_EQ(person.type, "person");
  EXPECT_EQ(parked.type, "car");
  EXPECT_TRUE(parked.velocity_in_body_m_per_s.isApprox(Eigen::Vector3d(-10, 0, 0), 1e-6));
  EXPECT_EQ(recording.reader->read_boxes(recording.box_files[2]).size(), 0u)
      << "frame 4 is outside the window of those that stand";
}

TEST_F(Kitti360, NamesObjectsBehindTheLastTime) {
  folder_.write(boxes_, kitti360::make_objects(
                            {made_object(26001, "car", 2, 20), made_object(26001, "car", 6, 30)}));
  EXPECT_EQ(opened().box_files.size(), 1u);
  EXPECT_THAT(findings(std::string(kKitti360Drive) + ".xml"),
              AllOf(HasSubstr("1 object of frames behind"), HasSubstr("not used: 6")));
}

TEST_F(Kitti360, RejectsObjectsThatCannotBe) {
  const std::string text = kitti360::make_objects({made_object(26001, "car", 2, 20)});
  folder_.write(boxes_, text);
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string changed = text;
    changed.replace(changed.find(from), from.size(), to);
    return message(boxes_, changed);
  };
  const std::string at = "opencv_storage.object1.";
  EXPECT_THAT(with("<timestamp>2", "<timestamp>two"), HasSubstr(at + "timestamp = two"));
  EXPECT_THAT(with("<rows>4", "<rows>3"), HasSubstr("transform"));
  EXPECT_THAT(with("<data>\n      4.", "<data>\n      nan 4."), HasSubstr("number of values"));
  EXPECT_THAT(with(" 20 ", " nan "), HasSubstr(at + "transform.data = nan"));
  EXPECT_THAT(with("<vertices", "<corners"), HasSubstr("no XML"));
  EXPECT_THAT(message(boxes_, "<a/>"), HasSubstr("opencv_storage: missing"));
  kitti360::Object skewed = made_object(26001, "car", 2, 20), huge = skewed;
  skewed.world_from_box.linear()(0, 1) += 0.5;
  huge.size_m.x() = 120;
  EXPECT_THAT(message(boxes_, kitti360::make_objects({skewed})), HasSubstr("not perpendicular"));
  EXPECT_THAT(message(boxes_, kitti360::make_objects({huge})), HasSubstr("0.01 and 100 m"));
}

TEST_F(Kitti360, NamesFileFieldAndValueOfWhatIsWrong) {
  const fs::path calibration = "calibration";
  for (const char* file :
       {"perspective.txt", "image_02.yaml", "calib_cam_to_pose.txt", "calib_cam_to_velo.txt"})
    EXPECT_THAT(message(calibration / file), HasSubstr(file));
  EXPECT_THAT(message(poses_), HasSubstr("poses.txt"));
  EXPECT_THAT(message(images_ / "image_00/timestamps.txt"), HasSubstr("image_00/timestamps.txt"));
  EXPECT_THAT(message(scans_ / "timestamps.txt"), HasSubstr("velodyne_points/timestamps.txt"));

  const auto poses = [&](const std::string& line) {
    return message(poses_, testing::kitti360_pose(2) + line + testing::kitti360_pose(4));
  };
  EXPECT_THAT(poses("3 1 0 0 3 0 -1 0 0 0 0 -1\n"),
              AllOf(HasSubstr("poses.txt"), HasSubstr("line 2, number of values = 12")));
  EXPECT_THAT(poses("3 1 0 0 103 0 -1 0 0 0 0 -1 0.9\n"),
              AllOf(HasSubstr("3.pose"), HasSubstr("101.00 m away from frame 2, 0.100 s later")));
  EXPECT_THAT(poses("3 1 0 0 nan 0 -1 0 0 0 0 -1 0.9\n"), HasSubstr("line 2, value 5 = nan"));
  EXPECT_THAT(poses("2 1 0 0 3 0 -1 0 0 0 0 -1 0.9\n"), HasSubstr("line 2, frame = 2"));
  EXPECT_THAT(poses("3 1 0 0 3 0 1 0 0 0 0 -1 0.9\n"), HasSubstr("reflection"));

  const fs::path scan = scans_ / "data/0000000003.bin";
  fs::resize_file(folder_.path / scan, 24);
  EXPECT_THAT(input_error([&] {
                const Recording recording = opened();
                EXPECT_EQ(recording.reader->lidar_point_count(recording.lidar_files[1]), 0u);
                recording.reader->read_lidar(recording.lidar_files[1]);
              }),
              AllOf(HasSubstr("0000000003.bin"), HasSubstr("24 bytes")));
  EXPECT_THAT(message(scans_ / "timestamps.txt", testing::kitti_timestamps(3, 4.99)),
              HasSubstr("has none for frame 3"));  // the first of the damaged records
  EXPECT_THAT(message(scans_ / "timestamps.txt", testing::kitti_timestamps(6, 8)),
              HasSubstr("3.000 s"));
  EXPECT_THAT(input_error([&] { open_recording(folder_.path, PoseSource::kGroundTruth); }),
              HasSubstr("exact poses"));
}

TEST_F(Kitti360, NamesCalibrationsThatCannotBe) {
  const auto with = [&](const char* file, std::string text, const std::string& from,
                        const std::string& to) {
    text.replace(text.find(from), from.size(), to);
    return message(fs::path("calibration") / file, text);
  };
  const auto yaml = [&](const std::string& from, const std::string& to) {
    return with("image_02.yaml", testing::kitti360_fisheye(), from, to);
  };
  EXPECT_THAT(yaml("MEI", "PINHOLE"), HasSubstr("model_type = \"PINHOLE\""));
  EXPECT_THAT(yaml("xi: 2.2134047507854890e+00", "xi: far"), HasSubstr("mirror_parameters.xi"));
  EXPECT_THAT(yaml("xi: 2.2134047507854890e+00", "xi: 30"), HasSubstr("0 <= xi <= 10"));
  EXPECT_THAT(yaml("xi: 2.2134047507854890e+00", "xi: .nan"), HasSubstr("mirror_parameters.xi"));
  EXPECT_THAT(yaml("   v0: 705.8\n", ""), HasSubstr("projection_parameters.v0"));
  EXPECT_THAT(yaml("gamma1: 1336.0", "gamma1: -1"), HasSubstr("gamma1 = -1"));
  EXPECT_THAT(yaml("image_height: 1400", "image_width: 1400"), HasSubstr("line 5, key"));
  EXPECT_THAT(with("perspective.txt", testing::kitti360_perspective(), "P_rect_00", "Q_rect_00"),
              HasSubstr("P_rect_00"));
  EXPECT_THAT(
      with("perspective.txt", testing::kitti360_perspective(), "552 0 682 0", "552 1 682 0"),
      HasSubstr("P_rect_00"));
  EXPECT_THAT(
      with("calib_cam_to_pose.txt", testing::kitti360_cam_to_pose(), "image_02", "image_03"),
      AllOf(HasSubstr("calib_cam_to_pose.txt"), HasSubstr("image_02")));
  EXPECT_THAT(with("calib_cam_to_pose.txt", testing::kitti360_cam_to_pose(), "1.5", "nan"),
              AllOf(HasSubstr("calib_cam_to_pose.txt"), HasSubstr("nan")));
  EXPECT_THAT(message("calibration/calib_cam_to_velo.txt", "0 0 1 0.8 -1 0 0 0 0 -1 0\n"),
              HasSubstr("number of values = 11"));
  EXPECT_THAT(message("calibration/calib_cam_to_velo.txt", "0 0 1 nan -1 0 0 0 0 -1 0 0\n"),
              AllOf(HasSubstr("calib_cam_to_velo.txt"), HasSubstr("nan")));
}

TEST_F(Kitti360, PosesOfOtherSoftwareReplaceItsOwn) {
  Recording recording = opened();
  std::vector<CameraCalibration> cameras;
  for (const RecordedCamera& camera : recording.cameras) cameras.push_back(camera.calibration);
  std::vector<FramePose> frames = recording.frames;
  frames[1].global_from_body.translation().y() += 0.5;
  const PoseFiles all = recording.reader->make_pose_files(recording, frames, cameras);
  apply_pose_files(all, "aligned", &recording);
  EXPECT_NEAR(recording.frames[1].global_from_body.translation().y(), 0.18, 1e-9);
}

// Files of the data set: the cameras look ahead, ahead, left and right, above the road.
TEST(RealKitti360, CalibrationIsRead) {
  const fs::path real = fs::path(REDRIVE_SHARED) / "data/kitti360/calibration";
  if (!fs::exists(real)) GTEST_SKIP() << real << " is not here";
  TemporaryFolder folder;
  testing::write_kitti360_drive(folder);
  fs::remove_all(folder.path / "calibration");
  fs::copy(real, folder.path / "calibration");
  const fs::path images = fs::path("data_2d_raw") / kKitti360Drive;
  for (int f = 2; f <= 4; ++f) {
    const std::string name = "000000000" + std::to_string(f) + ".png";
    folder.write(images / "image_01/data_rect" / name, testing::png_head(1408, 376, name));
    folder.write(images / "image_03/data_rgb" / name, testing::png_head(1400, 1400, name));
  }
  for (const char* camera : {"image_01", "image_03"})
    folder.write(images / camera / "timestamps.txt", testing::kitti_timestamps(6, 5));
  const Recording recording = open_recording(folder.path);
  ASSERT_EQ(recording.cameras.size(), 4u);
  const Eigen::Vector3d looks[] = {{1, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, -1, 0}};
  for (std::size_t c = 0; c < 4; ++c) {
    const CameraCalibration& calibration = recording.cameras[c].calibration;
    EXPECT_GT(calibration.body_from_sensor.linear().col(2).dot(looks[c]), 0.99) << c;
    EXPECT_NEAR(calibration.body_from_sensor.translation().z(), c < 2 ? 1.55 : 1.97, 0.01);
    const Camera camera = make_camera(calibration);
    std::size_t seen = 0;
    for (int y = 0; y < camera.height; y += 25)
      for (int x = 0; x < camera.width; x += 25) {
        const auto direction = camera.unproject({double(x), double(y)});
        if (!direction) continue;
        ++seen;
        EXPECT_LT((*camera.project(*direction) - Eigen::Vector2d(x, y)).norm(), 1e-4);
      }
    EXPECT_GT(seen, c < 2 ? 850u : 2000u) << "of 912 or 3136 pixels";
  }
  // 0.594 m of baseline, with parallel axes after rectification (files of 6 digits).
  const Rigid3d right_from_left = recording.cameras[1].calibration.body_from_sensor.inverse() *
                                  recording.cameras[0].calibration.body_from_sensor;
  EXPECT_NEAR(right_from_left.translation().x(), -0.594, 1e-3);
  EXPECT_NEAR(right_from_left.translation().tail<2>().norm(), 0, 2e-3);
  EXPECT_TRUE(right_from_left.linear().isIdentity(1e-3));
  EXPECT_NEAR(recording.lidars[0].body_from_lidar.translation().z(), 1.736, 1e-3);
  EXPECT_GT(recording.lidars[0].body_from_lidar.linear()(2, 2), 0.999) << "upright";
}

}  // namespace
}  // namespace redrive
