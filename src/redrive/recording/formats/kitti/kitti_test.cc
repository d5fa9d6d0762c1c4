// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti.h"

#include "redrive/base/files/files.h"
#include "redrive/recording/formats/kitti/kitti_testing.h"
#include "redrive/recording/formats/pose_files.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::kKittiDrive;

std::string kitti_findings(const Recording& recording, const std::string& subject) {
  std::string all;
  for (const Finding& finding : recording.findings)
    if (finding.subject == subject) all += finding.what + "\n";
  return all;
}

class Kitti : public ::testing::Test {
 protected:
  Kitti() { testing::write_kitti_drive(folder_); }
  Recording opened() const { return open_recording(folder_.path / kKittiDrive); }
  void write(const fs::path& file, const std::string& text) const {
    folder_.write(kKittiDrive / file, text);
  }
  void remove(const fs::path& file) const { fs::remove_all(folder_.path / kKittiDrive / file); }
  /// Message of the InputError about a file of the drive.
  std::string message() const {
    return input_error([&] { opened(); });
  }
  /// Why the first record of the drive is left out that cannot be used.
  std::string damage() const { return opened().damaged.at(0).why; }

  TemporaryFolder folder_;
};

TEST_F(Kitti, OpensADrive) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "kitti");
  EXPECT_TRUE(recording.metric);
  EXPECT_EQ(recording.global_frame, GlobalFrame::kEcef);
  ASSERT_EQ(recording.cameras.size(), 2u);
  EXPECT_EQ(recording.cameras[0].calibration.name, "image_00");
  const RecordedCamera& camera = recording.cameras[1];
  EXPECT_EQ(camera.calibration.name, "image_02");
  EXPECT_EQ(camera.calibration.model, "opencv_pinhole");
  EXPECT_EQ(camera.calibration.width, 1242);
  ASSERT_EQ(camera.images.size(), 3u);
  EXPECT_EQ(camera.images[1].frame_id, 3);
  EXPECT_EQ(camera.images[1].path, folder_.path / kKittiDrive / "image_02/data/0000000003.png");
  ASSERT_EQ(recording.frames.size(), 3u);
  EXPECT_EQ(recording.lidar_files.size(), 3u);
  EXPECT_TRUE(recording.findings.empty()) << recording.findings[0].what;
}

// The camera is 0.25 m ahead of the Velodyne and 0.08 m below it, which is 1.73 m above the ground
// and 0.76 m ahead of the rear axle, in the middle of the car.
TEST_F(Kitti, TheBodyIsOnTheGroundBelowTheRearAxle) {
  const Recording recording = opened();
  ASSERT_FALSE(recording.lidars.empty());
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.translation().isApprox(
      Eigen::Vector3d(0.76, 0, 1.73), 1e-12));
  const CameraCalibration& camera = recording.cameras[1].calibration;
  EXPECT_TRUE(camera.body_from_sensor.translation().isApprox(
      Eigen::Vector3d(1.01, 0.06, 1.65), 1e-12));  // camera 2 is to the left of camera 0
  EXPECT_TRUE((camera.body_from_sensor.linear() * Eigen::Vector3d::UnitZ())
                  .isApprox(Eigen::Vector3d::UnitX(), 1e-12));
}

// Packets are 10 ms after the images of the first camera; the car drives north at 10 m/s.
TEST_F(Kitti, PosesAreInterpolatedAtTheImages) {
  const Recording recording = opened();
  const std::vector<FramePose>& frames = recording.frames;
  EXPECT_EQ(frames[1].t_ns - frames[0].t_ns, 100'000'000);
  EXPECT_EQ(frames[0].t_ns % 1'000'000'000, 202'000'000);
  EXPECT_EQ(recording.cameras[0].calibration.time_offset_ns, 0);
  EXPECT_EQ(recording.cameras[1].calibration.time_offset_ns, -2'000'000);
  remove("image_00");
  const Recording later = opened();  // frames at image_02, 2 ms earlier
  const Eigen::Vector3d motion =
      frames[1].global_from_body.translation() - later.frames[1].global_from_body.translation();
  const Eigen::Vector3d forward = frames[1].global_from_body.linear().col(0);
  EXPECT_NEAR(motion.dot(forward), 0.02, 1e-4);  // 1 m of arc is not quite 0.1 s of 10 m/s
  EXPECT_GT(forward.z(), 0.6);                   // north at 49 degrees: cos(49)
}

TEST_F(Kitti, ReadsScansWithTheTimesOfTheirAzimuth) {
  const Recording recording = opened();
  const FrameFile& file = recording.lidar_files[0];
  EXPECT_EQ(recording.reader->lidar_point_count(file), 2u);
  const std::vector<LidarPoint> points = recording.reader->read_lidar(file);
  ASSERT_EQ(points.size(), 2u);
  EXPECT_LT((points[0].in_body_m - Eigen::Vector3f(0.76f, 10, 1.73f)).norm(), 1e-5);
  // Middle of the revolution at the images of image_02, 2 ms before the frame's time.
  const std::int64_t middle_ns = recording.frames[0].t_ns - 2'000'000;
  EXPECT_NEAR(static_cast<double>(points[1].t_ns - middle_ns), 0, 25e3);
  EXPECT_NEAR(static_cast<double>(points[0].t_ns - middle_ns), -25e6, 25e3);
}

TEST_F(Kitti, ReadsBoxes) {
  std::string labels;
  for (int f = 0; f < 6; ++f) labels += testing::kitti_label(f, 5, "Van", 20);
  write("label_02/0001.txt", labels);
  Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 3u);
  const std::vector<Box> boxes = recording.reader->read_boxes(recording.box_files[1]);
  ASSERT_EQ(boxes.size(), 1u);
  EXPECT_EQ(boxes[0].object_id, 5);
  EXPECT_EQ(boxes[0].type, "Van");
  // 20 m ahead of camera 0 and 1 m to its right; its bottom is 1.6 m below the camera.
  EXPECT_LT((boxes[0].body_from_box.translation() - Eigen::Vector3d(21.01, -1, 0.05 + 0.75)).norm(),
            1e-9);
  EXPECT_LT((boxes[0].body_from_box.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-9);
  // It keeps its distance.
  EXPECT_LT(boxes[0].velocity_in_body_m_per_s.norm(), 0.01);

  write("tracklet_labels.xml", "<boost_serialization><tracklets/></boost_serialization>");
  EXPECT_THAT(kitti_findings(opened(), "tracklet_labels.xml"), HasSubstr("label_02"));
  remove("label_02");
  EXPECT_TRUE(opened().box_files.empty());
  write("tracklet_labels.xml",
        "<boost_serialization><tracklets><item><objectType>Cyclist</objectType><h>1.8</h><w>0.6"
        "</w><l>1.8</l><first_frame>3</first_frame><poses><item><tx>20</tx><ty>-1</ty><tz>-1.73"
        "</tz><rx>0</rx><ry>0</ry><rz>0</rz></item></poses></item></tracklets>"
        "</boost_serialization>");
  recording = opened();
  ASSERT_EQ(recording.box_files.size(), 1u);
  const Box cyclist = recording.reader->read_boxes(recording.box_files[0]).at(0);
  EXPECT_EQ(cyclist.type, "Cyclist");
  EXPECT_LT((cyclist.body_from_box.translation() - Eigen::Vector3d(20.76, -1, 0.9)).norm(), 1e-9);
}

TEST_F(Kitti, WritesAndReadsAlignedPoses) {
  const Recording recording = opened();
  std::vector<FramePose> frames = recording.frames;
  frames[1].global_from_body.translation().x() += 0.5;
  std::vector<CameraCalibration> cameras;
  for (const RecordedCamera& camera : recording.cameras) cameras.push_back(camera.calibration);
  cameras[1].time_offset_ns = 3'000'000;
  write_pose_files(folder_.path / "aligned",
                   recording.reader->make_pose_files(recording, frames, cameras));
  Recording aligned = opened();
  apply_pose_files(read_pose_files(aligned, folder_.path / "aligned"), "aligned", &aligned);
  EXPECT_TRUE(aligned.frames[1].global_from_body.isApprox(frames[1].global_from_body, 1e-12));
  EXPECT_EQ(aligned.cameras[1].calibration.time_offset_ns, 3'000'000);
  EXPECT_EQ(aligned.lidar_files.size(), 3u);
}

TEST_F(Kitti, FindsTheCalibrationOfARelativePath) {
  const fs::path before = fs::current_path();
  fs::current_path(folder_.path / kKittiDrive);
  EXPECT_EQ(open_recording(".").cameras.size(), 2u);
  EXPECT_EQ(open_recording(folder_.path / kKittiDrive / "").cameras.size(), 2u);
  fs::current_path(before);
}

TEST_F(Kitti, FindsTheCalibrationInTheDrivesFolder) {
  const fs::path day = folder_.path / "2011_09_26", drive = folder_.path / kKittiDrive;
  fs::create_directory(drive / "calibration");
  for (const auto& [from, to] : {std::pair(day, drive), std::pair(drive, drive / "calibration")}) {
    for (const char* name :
         {"calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"})
      fs::rename(from / name, to / name);
    EXPECT_EQ(opened().cameras.size(), 2u);
  }
}

// A drive has packets and scans to its end, the excerpt images and times of a part.
TEST_F(Kitti, LeavesOutPacketsAndScansBehindTheTimes) {
  for (const int id : {7, 8}) {
    write("oxts/data/000000000" + std::to_string(id) + ".txt", testing::kitti_oxts(id));
    write("velodyne_points/data/000000000" + std::to_string(id) + ".bin",
          testing::kitti_scan({{10, 0, 0, 1}}));
  }
  write("oxts/timestamps.txt", testing::kitti_timestamps(8, 5.01));
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 3u);
  EXPECT_EQ(recording.lidar_files.size(), 3u);
  EXPECT_THAT(kitti_findings(recording, "oxts"), HasSubstr("frame 8"));
  EXPECT_THAT(kitti_findings(recording, "image_00"), HasSubstr("no time for frame 7"));
  EXPECT_THAT(kitti_findings(recording, "velodyne_points"), HasSubstr("frame 7, 8"));
}

// Files of times that were cut, one kind at a time.
TEST_F(Kitti, FramesBehindTheEndOfATimesFileCostThemselves) {
  const std::map<std::string, std::string> sensors = {
      {"oxts/timestamps.txt", "poses"},
      {"image_00/timestamps.txt", "times of image_00"},
      {"velodyne_points/timestamps_start.txt", "times of velodyne_points"},
      {"velodyne_points/timestamps_end.txt", "times of velodyne_points"}};
  for (const auto& [file, sensor] : sensors) {
    const std::string whole = read_file(folder_.path / kKittiDrive / file);
    const Recording before = opened();
    const std::int64_t last = before.frames.back().id;
    std::string cut;
    for (std::int64_t line = 0; line < last; ++line)
      cut += whole.substr(cut.size(), whole.find('\n', cut.size()) + 1 - cut.size());
    write(file, cut);
    Recording recording = opened();
    ASSERT_EQ(recording.damaged.size(), 1u) << file;
    EXPECT_EQ(recording.damaged[0].sensor, sensor);
    EXPECT_EQ(recording.damaged[0].frame_id, last);
    EXPECT_THAT(recording.damaged[0].why, HasSubstr(file + ": number of lines = "));
    EXPECT_EQ(recording.lidar_files.size() + (sensor == "times of velodyne_points" ? 1 : 0), 3u);
    EXPECT_EQ(recording.frames.size(), sensor == "times of velodyne_points" ? 3u : 2u);
    write(file, whole);
  }
}

TEST_F(Kitti, NamesMissingFiles) {
  for (const std::string name :
       {"calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"}) {
    const fs::path file = folder_.path / "2011_09_26" / name;
    fs::rename(file, file.string() + ".away");
    EXPECT_THAT(message(), AllOf(HasSubstr(name + ": missing"), HasSubstr("folder of the day")));
    fs::rename(file.string() + ".away", file);
  }
  for (const std::string name :
       {"oxts/timestamps.txt", "image_02/timestamps.txt", "velodyne_points/timestamps_start.txt",
        "velodyne_points/timestamps_end.txt"}) {
    const fs::path file = folder_.path / kKittiDrive / name;
    fs::rename(file, file.string() + ".away");
    EXPECT_THAT(message(), HasSubstr(name));
    fs::rename(file.string() + ".away", file);
  }
  remove("oxts/data");
  EXPECT_THAT(message(), HasSubstr("oxts/data: holds no pose"));
  write("oxts/data/0000000002.txt", testing::kitti_oxts(2));
  for (const std::string camera : {"image_00", "image_02"}) remove(camera + "/data");
  EXPECT_THAT(message(), AllOf(HasSubstr("empty recording"), HasSubstr("image_00: no image")));
}

TEST_F(Kitti, RejectsTimesThatDoNotFit) {
  write("image_02/timestamps.txt", testing::kitti_timestamps(3, 5));
  EXPECT_THAT(damage(), AllOf(HasSubstr("image_02/timestamps.txt: number of lines = 3"),
                              HasSubstr("frame 3"), HasSubstr("line n is of frame n - 1")));
  write("image_02/timestamps.txt", testing::kitti_timestamps(6, 5.4));
  EXPECT_THAT(damage(), AllOf(HasSubstr("image_02/timestamps.txt: line 3 = 0.398 s"),
                              HasSubstr("0.2 s apart")));
  write("image_02/timestamps.txt", testing::kitti_timestamps(6, 5));
  write("oxts/timestamps.txt", testing::kitti_timestamps(6, 4));
  EXPECT_THAT(message(), AllOf(HasSubstr("image_00/timestamps.txt: line 3 = 1.002 s"),
                               HasSubstr("oxts/timestamps.txt")));
  write("oxts/timestamps.txt", testing::kitti_timestamps(6, 5.01));
  write("velodyne_points/timestamps_end.txt", testing::kitti_timestamps(6, 4.95));
  EXPECT_THAT(damage(),
              AllOf(HasSubstr("timestamps_end.txt: line 3 = 0.000 s"), HasSubstr("revolution")));
  EXPECT_TRUE(opened().lidar_files.empty());
  write("velodyne_points/timestamps_start.txt", testing::kitti_timestamps(6, 15));
  write("velodyne_points/timestamps_end.txt", testing::kitti_timestamps(6, 15.1));
  EXPECT_THAT(damage(), AllOf(HasSubstr("timestamps_start.txt: line 3 = 10.0"),
                              HasSubstr("of the same frame")));
}

TEST_F(Kitti, ReportsFramesWithoutTime) {
  std::string times = testing::kitti_timestamps(6, 5.002);
  const std::size_t length = times.size() / 6;
  write("image_00/timestamps.txt", times.substr(0, 2 * length) + "\n" + times.substr(3 * length));
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 2u);
  EXPECT_THAT(kitti_findings(recording, "image_00"), HasSubstr("no time for frame 2"));
  write("image_00/timestamps.txt", times);
  times = testing::kitti_timestamps(6, 4.95);
  write("velodyne_points/timestamps_start.txt",
        times.substr(0, 3 * length) + "\n" + times.substr(4 * length));
  EXPECT_EQ(opened().lidar_files.size(), 2u);
  EXPECT_THAT(kitti_findings(opened(), "velodyne_points"), HasSubstr("frame 3"));
}

TEST_F(Kitti, NamesPacketsAndScansThatEndEarly) {
  std::string packet = testing::kitti_oxts(3);
  packet.resize(packet.rfind(' '));
  write("oxts/data/0000000003.txt", packet + "\n");
  EXPECT_THAT(damage(),
              AllOf(HasSubstr("oxts/data/0000000003.txt: "), HasSubstr("number of values = 29")));
  EXPECT_EQ(opened().frames.size(), 2u);
  write("oxts/data/0000000003.txt", testing::kitti_oxts(3));
  write("velodyne_points/data/0000000003.bin", testing::kitti_scan({{10, 0, 0, 1}}).substr(0, 12));
  EXPECT_THAT(input_error([&] {
                const Recording recording = opened();
                recording.reader->read_lidar(recording.lidar_files[1]);
              }),
              AllOf(HasSubstr("0000000003.bin"), HasSubstr("12 bytes")));
}

TEST_F(Kitti, APoseThatJumpsCostsItself) {
  write("oxts/data/0000000003.txt", testing::kitti_oxts(103));
  EXPECT_THAT(damage(), AllOf(HasSubstr("oxts/data: 3.latitude"), HasSubstr("101"),
                              HasSubstr("no car moves so")));
  EXPECT_EQ(opened().frames.size(), 2u);
}

TEST_F(Kitti, RejectsImagesOfACameraWithoutCalibration) {
  write("image_03/timestamps.txt", testing::kitti_timestamps(6, 5));
  write("image_03/data/0000000003.png", "");
  EXPECT_THAT(message(), AllOf(HasSubstr("calib_cam_to_cam.txt: P_rect_03"), HasSubstr("missing")));
}

TEST_F(Kitti, RejectsASecondFileOfLabels) {
  write("label_02/0000.txt", "");
  EXPECT_TRUE(opened().box_files.empty());
  write("label_02/0001.txt", "");
  EXPECT_THAT(message(), AllOf(HasSubstr("0001.txt"), HasSubstr("second")));
}

TEST_F(Kitti, HasNoGroundTruth) {
  EXPECT_THAT(
      input_error([&] { open_recording(folder_.path / kKittiDrive, PoseSource::kGroundTruth); }),
      HasSubstr("exact poses"));
}

class KittiSequence : public ::testing::Test {
 protected:
  KittiSequence() { testing::write_kitti_sequence(folder_); }
  Recording opened() const { return open_recording(folder_.path / "sequences/04"); }
  std::string message() const {
    return input_error([&] { opened(); });
  }
  TemporaryFolder folder_;
};

TEST_F(KittiSequence, Opens) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "kitti-odometry");
  EXPECT_EQ(recording.global_frame, GlobalFrame::kArbitrary);
  EXPECT_TRUE(recording.metric);
  ASSERT_EQ(recording.cameras.size(), 1u);
  const CameraCalibration& camera = recording.cameras[0].calibration;
  EXPECT_EQ(camera.name, "image_2");
  EXPECT_EQ(camera.width, 1226);
  EXPECT_EQ(camera.height, 370);
  EXPECT_TRUE(
      camera.body_from_sensor.translation().isApprox(Eigen::Vector3d(1.03, 0.06, 1.65), 1e-12));
  ASSERT_FALSE(recording.lidars.empty());
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.translation().isApprox(
      Eigen::Vector3d(0.78, 0, 1.73), 1e-12));
  ASSERT_EQ(recording.frames.size(), 3u);
  const Rigid3d motion =
      recording.frames[0].global_from_body.inverse() * recording.frames[2].global_from_body;
  EXPECT_TRUE(motion.translation().isApprox(Eigen::Vector3d(2, 0, 0), 1e-12));
  // Motion compensated: all points at the frame's time.
  const std::vector<LidarPoint> points = recording.reader->read_lidar(recording.lidar_files[1]);
  ASSERT_EQ(points.size(), 1u);
  EXPECT_EQ(points[0].t_ns, 100'000'000);
  EXPECT_EQ(points[0].intensity, 16384);
  EXPECT_TRUE(recording.findings.empty());
}

TEST_F(KittiSequence, NamesWhatIsMissing) {
  fs::remove(folder_.path / "poses/04.txt");
  EXPECT_THAT(message(), AllOf(HasSubstr("poses/04.txt: missing"), HasSubstr("00 to 10")));
  testing::write_kitti_sequence(folder_);
  fs::remove(folder_.path / "sequences/04/times.txt");
  EXPECT_THAT(message(), HasSubstr("times.txt"));
  testing::write_kitti_sequence(folder_);
  fs::remove(folder_.path / "sequences/04/calib.txt");
  EXPECT_THAT(message(), HasSubstr("calib.txt"));
  folder_.write("sequences/04/calib.txt", "P2: 720 0 600 0 0 720 180 0 0 0 1 0\n");
  EXPECT_THAT(message(), HasSubstr("calib.txt: Tr: missing"));
  folder_.write("sequences/04/calib.txt", "P0: 720 0 600 0 0 720 180 0 0 0 1 0\n");
  EXPECT_THAT(message(), HasSubstr("calib.txt: P2: missing"));
  testing::write_kitti_sequence(folder_);
  for (const fs::path& image : fs::directory_iterator(folder_.path / "sequences/04/image_2"))
    write_file(image, "GIF89a");
  EXPECT_THAT(message(), HasSubstr("000000.png: is no PNG image"));
  fs::remove_all(folder_.path / "sequences/04/image_2");
  EXPECT_THAT(message(), HasSubstr("empty recording"));
}

TEST_F(KittiSequence, RejectsScansThatEndEarly) {
  folder_.write("sequences/04/velodyne/000001.bin", "x, y, z");
  EXPECT_THAT(input_error([&] {
                const Recording recording = opened();
                recording.reader->read_lidar(recording.lidar_files[1]);
              }),
              AllOf(HasSubstr("000001.bin"), HasSubstr("7 bytes")));
}

// Excerpts have few images and the poses, or the times, of the whole sequence.
TEST_F(KittiSequence, LeavesOutLinesThatOneFileLacks) {
  folder_.write("sequences/04/times.txt", "0\n0.1\n0.2\n0.3\n0.4\n");
  folder_.write("sequences/04/velodyne/000004.bin", testing::kitti_scan({{10, 0, 0, 0.25f}}));
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 3u);
  EXPECT_THAT(kitti_findings(recording, "04.txt"), HasSubstr("the first 3 of both are used"));
  EXPECT_THAT(kitti_findings(recording, "velodyne"), HasSubstr("frame 4"));
}

TEST_F(KittiSequence, RejectsPosesThatDoNotFit) {
  folder_.write("poses/04.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
  const Recording one = opened();
  EXPECT_EQ(one.frames.size(), 1u);
  ASSERT_EQ(one.damaged.size(), 2u);
  EXPECT_THAT(one.damaged[1].why,
              AllOf(HasSubstr("04.txt: number of lines = 1"), HasSubstr("none for frame 2")));
  folder_.write("poses/04.txt",
                "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n1 0 0 0 0 1 0 0 0 0 1 101\n");
  EXPECT_THAT(opened().damaged.at(0).why,
              AllOf(HasSubstr("04.txt: 2.pose = 100.00 m"), HasSubstr("no car")));
}

}  // namespace
}  // namespace redrive
