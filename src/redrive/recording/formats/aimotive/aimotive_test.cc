// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/aimotive/aimotive.h"

#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/core/summary.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

std::string finding_about(const Recording& recording, const std::string& subject) {
  std::string all;
  for (const Finding& finding : recording.findings) {
    if (finding.subject == subject) all += finding.what + "\n";
  }
  return all;
}

TEST(Aimotive, OpensARecording) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  folder.write("dynamic/raw-revolutions/frame_0000009.laz", "");
  folder.write("dynamic/raw-revolutions/frame_10.LAS", "");
  folder.write("dynamic/raw-revolutions/notes.txt", "");
  folder.write("dynamic/box/3d_body/frame_0000009.json", "{}");
  folder.write("dynamic/box/3d_body/frame_0000010.json", "{}");
  folder.write("novel/left_1m/poses.json", "{}");
  fs::create_directories(folder.path / "novel/empty");
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.format, "aimotive");
  EXPECT_EQ(recording.root, folder.path);
  ASSERT_EQ(recording.cameras.size(), 2u);
  ASSERT_EQ(recording.cameras[0].images.size(), 3u);
  EXPECT_EQ(recording.cameras[0].images[2].frame_id, 11);
  EXPECT_EQ(recording.cameras[0].images[2].path,
            folder.path / "sensor/camera/F_CAM/F_CAM_0000011.jpg");
  EXPECT_EQ(recording.frames.size(), 3u);
  EXPECT_THAT(recording.other_sensors, ElementsAre("Imu0", "M_LIDAR"));
  ASSERT_EQ(recording.lidar_files.size(), 2u);
  EXPECT_EQ(recording.lidar_files[0].frame_id, 9);
  EXPECT_EQ(recording.lidar_files[0].path,
            folder.path / "dynamic/raw-revolutions/frame_0000009.laz");
  EXPECT_EQ(recording.lidar_files[1].frame_id, 10);
  ASSERT_EQ(recording.box_files.size(), 2u);
  EXPECT_EQ(recording.box_files[1].path, folder.path / "dynamic/box/3d_body/frame_0000010.json");
  EXPECT_THAT(finding_about(recording, "dynamic/raw-revolutions"),
              AllOf(HasSubstr("frame_<id>.laz or .las"), HasSubstr("notes.txt")));
  ASSERT_EQ(recording.novel.size(), 1u);
  EXPECT_EQ(recording.novel[0].name, "left_1m");
  EXPECT_THAT(finding_about(recording, "novel/empty"), HasSubstr("no poses.json"));
  EXPECT_TRUE(recording.lidars.empty());
  EXPECT_THAT(finding_about(recording, "lidar"), HasSubstr("RT_body_from_sensor"));
  EXPECT_EQ(recording.findings.size(), 3u);
  ASSERT_TRUE(recording.find_camera("L_FISH"));
  EXPECT_EQ(recording.find_camera("L_FISH")->calibration.model, "mei");
  EXPECT_FALSE(recording.find_camera("R_FISH"));
}

TEST(Aimotive, ReportsImagesWithoutPosesAndPosesWithoutImages) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  for (int id = 12; id < 20; ++id)
    folder.write("sensor/camera/F_CAM/F_CAM_00000" + std::to_string(id) + ".png", "");
  folder.write("sensor/camera/F_CAM/thumbnail.jpg", "");
  folder.write("sensor/camera/F_CAM/F_CAM_.jpg", "");
  fs::remove(folder.path / "sensor/camera/L_FISH/L_FISH_0000010.jpg");
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.cameras[0].images.size(), 3u);
  EXPECT_THAT(finding_about(recording, "F_CAM"),
              AllOf(HasSubstr("8 images dropped"), HasSubstr("12, 13, 14, 15, 16, ... (8 in all)"),
                    HasSubstr("2 files not named"), HasSubstr("thumbnail.jpg")));
  ASSERT_EQ(recording.cameras[1].images.size(), 2u);
  EXPECT_EQ(recording.cameras[1].images[1].frame_id, 11);
  EXPECT_THAT(finding_about(recording, "L_FISH"),
              HasSubstr("no image of 1 frame that other cameras have: 10"));
}

TEST(Aimotive, ReportsCamerasWithoutImagesOrCalibration) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  fs::remove_all(folder.path / "sensor/camera/L_FISH");
  folder.write("sensor/camera/R_FISH/R_FISH_0000009.jpg", "");
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.cameras.size(), 1u);
  EXPECT_THAT(finding_about(recording, "L_FISH"), HasSubstr("no folder"));
  EXPECT_THAT(finding_about(recording, "R_FISH"), HasSubstr("calibration.json does not have"));
}

TEST(Aimotive, UsesPointsWhereTheLidarHasNoPlace) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  folder.write("dynamic/raw-revolutions/frame_9.laz", "");
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
      "property float z\nend_header\n";
  folder.write("points.ply", header + "0 0 nan\n1 2 3\n4 5 6\n");
  const Recording without = open_recording(folder.path);
  EXPECT_TRUE(without.lidar_files.empty());
  EXPECT_FALSE(without.points_file.empty());
  EXPECT_THAT(finding_about(without, "lidar"), HasSubstr("RT_body_from_sensor"));
  EXPECT_THAT(finding_about(without, "points.ply"), HasSubstr("1 point not finite"));
  EXPECT_EQ(without.reader->read_points(without).size(), 2u);
  folder.write("points.ply", header);
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }), HasSubstr("points.ply"));
  nlohmann::json sensors = testing::calibration();
  sensors["M_LIDAR"]["RT_body_from_sensor"] = {
      {1, 0, 0, 1}, {0, 1, 0, 0}, {0, 0, 1, 2}, {0, 0, 0, 1}};
  folder.write("sensor/calibration/calibration.json", sensors.dump());
  const Recording with = open_recording(folder.path);
  EXPECT_EQ(with.lidar_files.size(), 1u);
  EXPECT_THAT(finding_about(with, "points.ply"), HasSubstr("not used"));
}

TEST(Aimotive, RejectsTwoImagesOfOneFrame) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  folder.write("sensor/camera/F_CAM/F_CAM_10.jpeg", "");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("F_CAM_10.jpeg"), HasSubstr("F_CAM_0000010.jpg")));
}

TEST(Aimotive, RejectsTwoRevolutionsOfOneFrame) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  folder.write("dynamic/raw-revolutions/frame_0000009.laz", "");
  folder.write("dynamic/raw-revolutions/frame_0000009.las", "");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("frame_0000009.laz"), HasSubstr("frame_0000009.las")));
}

// Recorded poses carry errors; ground truth is read where a recording ships it, and used on
// request.
TEST(Aimotive, ReadsGroundTruthPosesAndCalibration) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  EXPECT_TRUE(open_recording(folder.path).ground_truth_frames.empty());
  EXPECT_THAT(input_error([&] { open_recording(folder.path, PoseSource::kGroundTruth); }),
              HasSubstr("_true.json"));
  nlohmann::json poses = testing::egomotion(), cameras = testing::calibration();
  poses["9"] = testing::pose_at(0.06, 50.0);
  cameras["F_CAM"]["time_offset_s"] = 0.01;
  folder.write("sensor/gnssins/egomotion2_true.json", poses.dump());
  folder.write("sensor/calibration/calibration_true.json", cameras.dump());
  const Recording recording = open_recording(folder.path),
                  ground_truth = open_recording(folder.path, PoseSource::kGroundTruth);
  EXPECT_EQ(recording.frames[0].global_from_body.translation().x(), 4e6);
  EXPECT_EQ(recording.ground_truth_frames[0].global_from_body.translation().x(), 4e6 + 0.06);
  EXPECT_EQ(ground_truth.frames[0].global_from_body.translation().x(), 4e6 + 0.06);
  EXPECT_EQ(recording.cameras[0].calibration.time_offset_ns, 0);
  EXPECT_EQ(ground_truth.cameras[0].calibration.time_offset_ns, 10'000'000);
  EXPECT_EQ(recording.findings.size(), ground_truth.findings.size());
}

TEST(Aimotive, RejectsEmptyRecordings) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  fs::remove_all(folder.path / "sensor/camera");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("sensor/camera"), HasSubstr("empty recording"), HasSubstr("F_CAM")));
}

TEST(Aimotive, RejectsRecordingsWithoutPosedImages) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  folder.write("sensor/gnssins/egomotion2.json",
               nlohmann::json{{"7", testing::pose_at(0, 0)}}.dump());
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("empty recording"), HasSubstr("no pose for frame 9, 10, 11")));
}

TEST(Aimotive, ReportsMissingFiles) {
  TemporaryFolder folder;
  testing::write_recording(folder);
  fs::rename(folder.path / "sensor/gnssins/egomotion2.json",
             folder.path / "sensor/gnssins/egomotion.json");
  EXPECT_EQ(open_recording(folder.path).frames.size(), 3u);
  fs::remove(folder.path / "sensor/gnssins/egomotion.json");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("egomotion2.json"), HasSubstr("egomotion.json")));
  fs::remove(folder.path / "sensor/calibration/calibration.json");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }), HasSubstr("calibration.json"));
}

TEST(Registry, RejectsUnknownFolders) {
  TemporaryFolder folder;
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr(folder.path.string()), HasSubstr("sensor/calibration")));
  EXPECT_THAT(input_error([&] { open_recording(folder.path / "nothing"); }),
              HasSubstr("no such folder"));
  folder.write("file", "");
  EXPECT_THAT(input_error([&] { open_recording(folder.path / "file"); }), HasSubstr("folder"));
}

// A real recording; the expected values are copied from its files.
TEST(Aimotive, OpensARealRecording) {
  const fs::path root = fs::path(REDRIVE_SHARED) / "data/aimotive_night";
  if (!fs::exists(root)) GTEST_SKIP() << root << " is not here";
  const Recording recording = open_recording(root);
  ASSERT_EQ(recording.cameras.size(), 4u);
  EXPECT_THAT(recording.other_sensors,
              ElementsAre("B_LRR_C", "F_LRR_C", "Imu0", "M_LIDAR_M", "novatel", "ublox_gps"));
  ASSERT_FALSE(recording.lidars.empty());
  EXPECT_NEAR(recording.lidars[0].body_from_lidar.translation().z(), 1.6823, 1e-4);
  ASSERT_EQ(recording.frames.size(), 50u);
  EXPECT_EQ(recording.frames.front().id, 33643);
  EXPECT_EQ(recording.frames.back().id, 33692);
  EXPECT_EQ(recording.frames[1].t_ns, 4833238566000);
  EXPECT_EQ(recording.frames[0].global_from_body.translation(),
            Eigen::Vector3d(4081775.097907977, 1405467.8774478436, 4679608.337586997));
  EXPECT_NEAR(recording.frames[0].global_from_body.linear()(0, 1), 0.7577768261156472, 1e-12);
  for (const RecordedCamera& camera : recording.cameras)
    EXPECT_EQ(camera.images.size(), 50u) << camera.calibration.name;
  EXPECT_TRUE(recording.findings.empty());
  EXPECT_EQ(recording.lidar_files.size(), 50u);
  EXPECT_EQ(recording.box_files.size(), 50u);

  const CameraCalibration& front = recording.find_camera("F_MIDLONGRANGECAM_CL")->calibration;
  EXPECT_EQ(front.fx(), 1170.7994384765625);
  EXPECT_EQ(front.fy(), 1001.1844482421875);
  EXPECT_EQ(front.cy(), 352);
  EXPECT_EQ(front.parameters[6], 0.002034867648035288);
  EXPECT_EQ(front.body_from_sensor.translation().x(), 1.9311000108718872);
  EXPECT_NEAR(front.body_from_sensor.linear()(0, 2), 0.9997145375588449, 1e-12);
  const CameraCalibration& left = recording.find_camera("M_FISHEYE_L")->calibration;
  EXPECT_EQ(left.model, "mei");
  EXPECT_EQ(left.parameters.back(), 1.0222136193840399);
  EXPECT_EQ(recording.find_camera("B_MIDRANGECAM_C")->calibration.height, 1216);

  // SOURCE.md of the recording: 3.27 s, 98 m, 15 Hz, 30.10 to 29.88 m/s.
  const DriveSummary drive = summarize_drive(recording.frames);
  EXPECT_NEAR(drive.duration_s, 3.27, 0.005);
  EXPECT_NEAR(drive.path_length_m, 98, 0.5);
  EXPECT_NEAR(drive.rate_hz, 15, 0.02);
  EXPECT_GT(drive.mean_speed_m_per_s, 29.88);
  EXPECT_LT(drive.mean_speed_m_per_s, 30.10);
  EXPECT_TRUE(drive.findings.empty());
}

}  // namespace
}  // namespace redrive
