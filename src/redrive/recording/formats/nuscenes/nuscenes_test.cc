// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes.h"

#include <functional>

#include "redrive/recording/formats/nuscenes/nuscenes_testing.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::NuScenesTables;

constexpr std::int64_t kFirst_ns = 1000 * NuScenesTables::kFirst_us;

class NuScenes : public ::testing::Test {
 protected:
  NuScenes() { tables_.write(folder_); }
  Recording opened() const { return open_recording(folder_.path / "v1.0-mini/scene-0061"); }
  /// Opens what is left without these of the files.
  Recording opened_without(const std::string& part) const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::recursive_directory_iterator(folder_.path))
      if (entry.is_regular_file() && entry.path().string().find(part) != std::string::npos)
        files.push_back(entry.path());
    for (const fs::path& file : files) fs::remove(file);
    return opened();
  }

  TemporaryFolder folder_;
  NuScenesTables tables_;
};

TEST_F(NuScenes, OpensAScene) {
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "nuscenes");
  EXPECT_TRUE(recording.metric);
  EXPECT_EQ(recording.global_frame, GlobalFrame::kArbitrary);
  EXPECT_TRUE(recording.findings.empty()) << recording.findings[0].what;
  ASSERT_EQ(recording.cameras.size(), 2u);
  EXPECT_EQ(recording.cameras[0].calibration.name, "CAM_BACK");
  EXPECT_EQ(recording.cameras[1].images.size(), 13u);
  EXPECT_EQ(recording.cameras[1].images[1].path.filename(), "CAM_FRONT1532402927100000.jpg");
  EXPECT_EQ(recording.other_sensors, (std::vector<std::string>{"LIDAR_TOP", "RADAR_FRONT"}));
  EXPECT_EQ(recording.frames.size(), 13u);
  EXPECT_EQ(recording.lidar_files.size(), 13u);
  EXPECT_EQ(recording.box_files.size(), 13u);
}

TEST_F(NuScenes, MissingTablesOfBoxesCostTheBoxes) {
  const Recording recording = opened_without("instance.json");
  EXPECT_EQ(recording.frames.size(), 13u);
  EXPECT_TRUE(recording.box_files.empty());
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].what, "none: instance.json missing in v1.0-mini");
}

TEST_F(NuScenes, EachImageHasThePoseOfItsTime) {
  const Recording recording = opened();
  EXPECT_EQ(recording.cameras[0].calibration.time_offset_ns, 25'000'000);
  EXPECT_EQ(recording.cameras[1].calibration.time_offset_ns, 0);
  const FramePose& frame = recording.frames[2];
  EXPECT_EQ(frame.id, 2);
  EXPECT_EQ(frame.t_ns, kFirst_ns + 150'000'000);
  EXPECT_TRUE(
      frame.global_from_body.translation().isApprox(Eigen::Vector3d(1001.5, 600, 0), 1e-12));
}

TEST_F(NuScenes, APathNamesASceneByNameOrToken) {
  EXPECT_TRUE(nuscenes::looks_like(folder_.path));
  EXPECT_TRUE(nuscenes::looks_like(folder_.path / "v1.0-mini/any"));
  EXPECT_FALSE(nuscenes::looks_like(folder_.path / "samples"));
  EXPECT_FALSE(nuscenes::looks_like(folder_.path / "nothing/scene-0061"));
  for (const char* path : {"scene-0061", "v1.0-mini/scene-0061/", "v1.0-mini/t-scene-0061"})
    EXPECT_EQ(open_recording(folder_.path / path).frames[0].t_ns, kFirst_ns) << path;
  EXPECT_THAT(input_error([&] { open_recording(folder_.path / "scene-1"); }),
              AllOf(HasSubstr("scene-1: no such scene"), HasSubstr("scene-0061, scene-0103")));
  EXPECT_THAT(input_error([&] { open_recording(folder_.path); }),
              AllOf(HasSubstr("several scenes"), HasSubstr("v1.0-mini/scene-0061")));
  EXPECT_THAT(input_error([&] { open_recording(folder_.path / "nothing/scene-0061"); }),
              HasSubstr("no such folder"));
  fs::create_directory(folder_.path / "v1.0-test");
  fs::copy(folder_.path / "v1.0-mini/scene.json", folder_.path / "v1.0-test");
  EXPECT_THAT(
      input_error([&] { open_recording(folder_.path / "scene-0061"); }),
      AllOf(HasSubstr("several versions, v1.0-mini and v1.0-test"), HasSubstr("scene-0061")));
  EXPECT_THAT(input_error([&] {
                open_recording(folder_.path / "v1.0-mini/scene-0061", PoseSource::kGroundTruth);
              }),
              HasSubstr("no other, exact poses"));
}

TEST_F(NuScenes, TheOnlySceneNeedsNoName) {
  tables_["scene"].erase(0);
  tables_.write(folder_);
  EXPECT_EQ(open_recording(folder_.path).frames[0].t_ns, kFirst_ns + 100'000'000'000);
}

// Points 10 m ahead of the LiDAR, in one column.
TEST_F(NuScenes, ReadsRevolutions) {
  const Recording recording = opened();
  const FrameFile& file = recording.lidar_files[3];
  EXPECT_EQ(file.frame_id, 3);
  EXPECT_EQ(recording.reader->lidar_point_count(file), 32u);
  const std::vector<LidarPoint> points = recording.reader->read_lidar(file);
  ASSERT_EQ(points.size(), 32u);
  EXPECT_EQ(points[0].t_ns, kFirst_ns + 285'000'000);
  EXPECT_LT((points[0].in_body_m - Eigen::Vector3f(10.9f, 0, 1.8f)).norm(), 1e-5f);
  EXPECT_EQ(points[0].intensity, 7);
}

TEST_F(NuScenes, RevolutionsWithoutAnImageBelongToTheNearestFrame) {
  for (nlohmann::json& file : tables_["sample_data"])
    if (std::string(file["filename"]).find("FRONT1532402927250000") != std::string::npos ||
        std::string(file["filename"]).find("BACK1532402927275000") != std::string::npos)
      file["sample_token"] = "scene-0103-0";  // 250 ms after the first image
  tables_.write(folder_);
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 12u);
  ASSERT_EQ(recording.lidar_files.size(), 13u);
  // Its middle is at 260 ms; frames 2 and 3 are at 150 and 350 ms.
  EXPECT_EQ(recording.lidar_files[3].frame_id, 3);
  EXPECT_EQ(recording.lidar_files[4].frame_id, 3);
}

// The laser points ahead after a quarter of the revolution, which ends 35 ms after the image: cars
// are annotated as they were 35 - 50 + 12.5 = -2.5 ms after it.
TEST_F(NuScenes, BoxesAreInterpolatedToEveryFrame) {
  const Recording recording = opened();
  for (const FrameFile& file : recording.box_files) {
    const std::vector<Box> boxes = recording.reader->read_boxes(file);
    const FramePose& frame = recording.frames[std::size_t(file.frame_id)];
    const double t_s = 1e-9 * static_cast<double>(frame.t_ns - kFirst_ns);
    ASSERT_EQ(boxes.size(), 2u);
    const Box& car = boxes[0];
    EXPECT_EQ(car.type, "vehicle.car");
    EXPECT_EQ(car.t_ns, frame.t_ns);
    EXPECT_EQ(car.size_m, Eigen::Vector3d(4.5, 2, 1.5));
    const Eigen::Vector3d car_m(20 + 8 * (t_s + 0.0025) - 10 * t_s, 0, 0.9);
    EXPECT_LT((car.body_from_box.translation() - car_m).norm(), 0.02) << t_s;
    EXPECT_LT((car.velocity_in_body_m_per_s - Eigen::Vector3d(-2, 0, 0)).norm(), 0.02) << t_s;
    EXPECT_EQ(boxes[1].actor_name, "human.pedestrian.adult 1");
    EXPECT_LT(
        (boxes[1].body_from_box.translation() - Eigen::Vector3d(20 - 10 * t_s, 4, 0.9)).norm(),
        1e-6);
  }
}

TEST_F(NuScenes, BoxesAreNotInterpolatedOverLongGaps) {
  nlohmann::json kept = nlohmann::json::array();
  for (const nlohmann::json& box : tables_["sample_annotation"])
    if (box["sample_token"] != "scene-0061-1") kept.push_back(box);
  tables_["sample_annotation"] = kept;
  tables_.write(folder_);
  EXPECT_EQ(opened().box_files.size(), 13u) << "1 s, one key frame without";
  for (nlohmann::json& sample : tables_["sample"])
    if (sample["token"] == "scene-0061-2")
      sample["timestamp"] = NuScenesTables::kFirst_us + 1'300'000;
  tables_.write(folder_);
  const Recording recording = opened();
  ASSERT_EQ(recording.box_files.size(), 1u) << "of the first key frame";
  EXPECT_EQ(recording.box_files[0].frame_id, 0);
}

TEST_F(NuScenes, ReadsWhatIsThere) {
  const Recording recording = opened_without("sweeps");
  ASSERT_EQ(recording.frames.size(), 3u);
  EXPECT_EQ(recording.frames[1].id, 6) << "ids are those of the tables";
  EXPECT_EQ(recording.lidar_files.size(), 3u);
  EXPECT_EQ(recording.lidar_files[1].frame_id, 6);
  ASSERT_EQ(recording.findings.size(), 3u);
  EXPECT_THAT(recording.findings[0].what, HasSubstr("10 files of the tables missing: CAM_FRONT"));
  EXPECT_EQ(opened_without("CAM_BACK").cameras.size(), 1u);
  EXPECT_THAT(input_error([&] { opened_without("CAM_FRONT"); }),
              AllOf(HasSubstr("empty recording"), HasSubstr("3 files of the tables missing")));
}

TEST_F(NuScenes, AnImageOffItsOffsetIsAFrameOfItsOwn) {
  for (nlohmann::json& file : tables_["sample_data"])
    if (file["token"] == "CAM_BACK1532402927125000") file["timestamp"] = 1532402927131000;
  tables_.write(folder_);
  const Recording recording = opened();
  ASSERT_EQ(recording.frames.size(), 14u);
  EXPECT_EQ(recording.frames[2].t_ns, kFirst_ns + 106'000'000);
  EXPECT_EQ(recording.cameras[0].images[1].frame_id, 2);
  EXPECT_EQ(recording.cameras[1].images[1].frame_id, 1);
}

TEST_F(NuScenes, RejectsWhatCannotBe) {
  const auto message = [&](const std::function<void(NuScenesTables&)>& change) {
    NuScenesTables tables;
    change(tables);
    tables.write(folder_);
    return input_error([&] { opened(); });
  };
  EXPECT_THAT(message([](NuScenesTables& t) {
                for (nlohmann::json& file : t["sample_data"])
                  if (std::string(file["token"]).starts_with("CAM_BACK"))
                    file["is_key_frame"] = false;
              }),
              HasSubstr("CAM_BACK: has no key frame together with CAM_FRONT"));
  const auto damage = [&](const std::function<void(NuScenesTables&)>& change) {
    NuScenesTables tables;
    change(tables);
    tables.write(folder_);
    return opened().damaged.at(0).why;
  };
  EXPECT_THAT(
      damage([](NuScenesTables& t) { t["sample_data"][4]["timestamp"] = 1532402927150001; }),
      AllOf(HasSubstr("sample_data.json: CAM_FRONT = "), HasSubstr("less than 5 ms after")));
  EXPECT_THAT(damage([](NuScenesTables& t) {
                t["sample_data"][1]["timestamp"] = NuScenesTables::kFirst_us + 200'001;
              }),
              HasSubstr("more than 0.2 s from CAM_FRONT in the same sample"));
  EXPECT_THAT(damage([](NuScenesTables& t) { t["ego_pose"][4]["translation"][0] = 1100; }),
              AllOf(HasSubstr("ego_pose.json: "), HasSubstr("no car moves so")));
  for (const auto& [table, records] : tables_) {
    if (table == "sample_annotation" || table == "instance" || table == "category") continue;
    tables_.write(folder_);
    fs::remove(folder_.path / ("v1.0-mini/" + table + ".json"));
    EXPECT_THAT(input_error([&] { opened(); }), HasSubstr(table + ".json: No such file")) << table;
  }
}

TEST_F(NuScenes, WritesPosesThatItReads) {
  Recording recording = opened();
  const TemporaryFolder aligned;
  std::vector<FramePose> frames = recording.frames;
  for (FramePose& frame : frames) frame.global_from_body.translation().z() += 0.25;
  std::vector<CameraCalibration> cameras;
  for (const RecordedCamera& camera : recording.cameras) cameras.push_back(camera.calibration);
  write_pose_files(aligned.path, recording.reader->make_pose_files(recording, frames, cameras));
  apply_pose_files(read_pose_files(recording, aligned.path), aligned.path, &recording);
  EXPECT_EQ(recording.frames[5].global_from_body.translation().z(), 0.25);
  EXPECT_EQ(recording.cameras[0].calibration.time_offset_ns, 25'000'000);
}

}  // namespace
}  // namespace redrive
