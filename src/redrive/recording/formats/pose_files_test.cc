// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pose_files.h"

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr const char *kEgomotion = "sensor/gnssins/egomotion2.json",
                     *kCalibration = "sensor/calibration/calibration.json";

struct Fixture {
  TemporaryFolder folder;
  Recording recording;
  Fixture() {
    testing::write_recording(folder);
    recording = open_recording(folder.path);
  }
};

void expect_round_trip(const Fixture& f) {
  std::vector<FramePose> frames = f.recording.frames;
  std::vector<CameraCalibration> cameras;
  for (const RecordedCamera& camera : f.recording.cameras) cameras.push_back(camera.calibration);
  frames[1].global_from_body =
      frames[1].global_from_body * Eigen::AngleAxisd(0.001, Eigen::Vector3d::UnitZ());
  frames[1].global_from_body.translation().x() += 0.0625;
  cameras[0].body_from_sensor =
      cameras[0].body_from_sensor * Eigen::AngleAxisd(-0.002, Eigen::Vector3d::UnitY());
  cameras[0].body_from_sensor.translation().y() += 0.25;
  cameras[1].time_offset_ns = -12'000'001;
  cameras[1].parameters[0] = 1172.125;
  cameras[1].readout_ns = 29'999'999;
  Recording aligned = f.recording;
  aligned.lidars = {{"lidar", Rigid3d::Identity(), 0.003}, {"second", Rigid3d::Identity()}};
  write_pose_files(f.folder.path / "aligned",
                   f.recording.reader->make_pose_files(aligned, frames, cameras));
  Recording again = f.recording;
  again.lidars = {{"lidar"}, {"second"}};
  apply_pose_files(read_pose_files(f.recording, f.folder.path / "aligned"),
                   f.folder.path / "aligned", &again);
  EXPECT_NEAR(again.lidars[0].elevation_rad, 0.003, 1e-15);
  EXPECT_EQ(again.lidars[1].elevation_rad, 0);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(again.frames[i].id, frames[i].id);
    EXPECT_EQ(again.frames[i].t_ns, frames[i].t_ns);
    EXPECT_EQ(again.frames[i].global_from_body.translation(),
              frames[i].global_from_body.translation());
    // Reading makes rotations orthonormal.
    EXPECT_TRUE(again.frames[i].global_from_body.linear().isApprox(
        frames[i].global_from_body.linear(), 1e-14));
  }
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const CameraCalibration& now = again.cameras[c].calibration;
    EXPECT_TRUE(now.body_from_sensor.isApprox(cameras[c].body_from_sensor, 1e-14));
    EXPECT_EQ(now.time_offset_ns, cameras[c].time_offset_ns);
    EXPECT_EQ(now.readout_ns, cameras[c].readout_ns);
    EXPECT_EQ(now.parameters, cameras[c].parameters);
    EXPECT_EQ(again.cameras[c].images.size(), 3u);
  }
}

TEST(PoseFiles, RoundTrip) {
  Fixture f;
  expect_round_trip(f);
}

TEST(PoseFiles, RoundTripOfFormatsWithoutTheirOwn) {
  Fixture f;
  f.recording.reader = basic_reader();
  expect_round_trip(f);
}

TEST(PoseFiles, OmitReadoutsThatAreZero) {
  Fixture f;
  const CameraCalibration& camera = f.recording.cameras[0].calibration;
  const auto sensor = [&] {
    const PoseFiles files =
        f.recording.reader->make_pose_files(f.recording, f.recording.frames, {camera});
    return nlohmann::json::parse(files.at(kCalibration)).at(camera.name);
  };
  EXPECT_FALSE(sensor().contains("readout_s"));
  f.recording.cameras[0].calibration.readout_ns = 30'000'000;
  EXPECT_EQ(sensor().at("readout_s"), 0.03);
}

TEST(PoseFiles, RejectsFilesOfAnotherRecording) {
  Fixture f;
  const PoseFiles files = read_pose_files(f.recording, f.folder.path);
  const auto error_message = [&](const char* name, const nlohmann::json& document) {
    Recording recording = f.recording;
    PoseFiles changed = files;
    changed[name] = document.dump();
    return testing::input_error([&] { apply_pose_files(changed, "other", &recording); });
  };
  nlohmann::json poses = testing::egomotion();
  poses["19"] = poses["9"], poses["20"] = poses["10"];
  for (const char* id : {"9", "10", "11"}) poses.erase(id);
  EXPECT_THAT(error_message(kEgomotion, poses),
              AllOf(HasSubstr("egomotion2.json"), HasSubstr("9"), HasSubstr("another drive")));
  poses = testing::egomotion();
  for (const char* id : {"9", "10", "11"})
    poses[id]["time_host"] = poses[id]["time_host"].get<double>() + 5;
  EXPECT_THAT(error_message(kEgomotion, poses),
              AllOf(HasSubstr("9.time"), HasSubstr("another drive")));
  nlohmann::json sensors = testing::calibration();
  sensors.erase("L_FISH");
  EXPECT_THAT(error_message(kCalibration, sensors),
              AllOf(HasSubstr("calibration.json"), HasSubstr("L_FISH")));
  f.recording.metric = false;
  EXPECT_THAT(error_message(kEgomotion, testing::egomotion()), HasSubstr("photographs"));
  EXPECT_THAT(
      testing::input_error([&] { read_pose_files(f.recording, f.folder.path / "nothing"); }),
      HasSubstr("egomotion2.json"));
}

// As align --cameras writes them where the other cameras have images of more frames.
TEST(PoseFiles, LeavesOutFramesThatTheyLack) {
  Fixture f;
  PoseFiles files = read_pose_files(f.recording, f.folder.path);
  nlohmann::json poses = testing::egomotion();
  poses.erase("10");
  files[kEgomotion] = poses.dump();
  apply_pose_files(files, "other", &f.recording);
  ASSERT_EQ(f.recording.frames.size(), 2u);
  EXPECT_EQ(f.recording.frames[1].id, 11);
  EXPECT_EQ(f.recording.cameras[0].images.size(), 2u);
  EXPECT_THAT(f.recording.findings.back().what, HasSubstr("2 frames of 3"));
}

TEST(PoseFiles, ADamagedPoseCostsItself) {
  const auto apply = [](const nlohmann::json& poses, Recording* recording, FrameRange frames) {
    PoseFiles files = read_pose_files(*recording, recording->root);
    files[kEgomotion] = poses.dump();
    apply_pose_files(files, "other", recording, frames);
  };
  for (const int kind : {0, 1, 2}) {
    Fixture f;
    nlohmann::json poses = testing::egomotion();
    if (kind == 0) poses["10"]["RT_ECEF_body"] = "none";
    if (kind == 1) poses["10"]["time_host"] = 50.15;  // the time of another drive's frame
    if (kind == 2) poses["10"]["RT_ECEF_body"][0][3] = 1e6;
    apply(poses, &f.recording, {});
    ASSERT_EQ(f.recording.frames.size(), 2u) << kind;
    EXPECT_EQ(f.recording.frames[1].id, 11);
    EXPECT_EQ(f.recording.cameras[0].images.size(), 2u);
    ASSERT_EQ(f.recording.damaged.size(), 1u);
    EXPECT_THAT(
        f.recording.findings.back().what,
        AllOf(HasSubstr("1 of 3 records left out: frame 10: "), HasSubstr("egomotion2.json: 10.")));
  }
}

TEST(PoseFiles, ManyDamagedPosesAreAnError) {
  Fixture f;
  PoseFiles files = read_pose_files(f.recording, f.folder.path);
  nlohmann::json poses = testing::egomotion();
  for (const char* id : {"9", "10"}) poses[id]["time_host"] = "soon";
  files[kEgomotion] = poses.dump();
  const auto apply = [&](double percent, const FrameRange& frames) {
    Recording recording = f.recording;
    recording.most_damaged_percent = percent;
    apply_pose_files(files, "other", &recording, frames);
    return recording;
  };
  EXPECT_THAT(
      testing::input_error([&] { apply(5, {}); }),
      AllOf(HasSubstr("2 of 3 records cannot be used, more than 5 %"), HasSubstr("9.time_host")));
  EXPECT_EQ(apply(70, {}).frames.size(), 1u);
  EXPECT_EQ(apply(5, {10, 11, 1}).frames.size(), 1u);  // frame 9 is not asked for
}

}  // namespace
}  // namespace redrive
