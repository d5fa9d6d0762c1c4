// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/recording_json.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using testing::input_error;

Rigid3d turned(double angle_rad, double x_m) {
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() =
      Eigen::AngleAxisd(angle_rad, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  pose.translation() << x_m, 1.0 / 3, -4.6e6 / 7;
  return pose;
}

/// Boxes of a frame.
class TwoBoxes : public RecordingReader {
 public:
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    Box box{.object_id = 7,
            .type = "CAR",
            .actor_name = "",
            .t_ns = file.frame_id * 100,
            .body_from_box = turned(0.1, 9),
            .size_m = {4, 2, 1.0 / 7},
            .velocity_in_body_m_per_s = {0.1, -1.0 / 3, 0}};
    Box other = box;
    other.object_id = 8;
    return {box, other};
  }
};

Recording recorded() {
  Recording recording;
  recording.format = "kitti";
  recording.global_frame = GlobalFrame::kArbitrary;
  RecordedCamera camera;
  camera.calibration = {.name = "left",
                        .model = "mei",
                        .parameters = {300.1, 299.9, 320, 240, 0.1, -0.2, 1e-3, 2e-3, 0, 1.02},
                        .width = 640,
                        .height = 480,
                        .body_from_sensor = turned(1.5, 0.1),
                        .time_offset_ns = -12'345'678,
                        .readout_ns = 30'000'001,
                        .readout_by_column = true};
  for (const std::int64_t id : {3, 4, 6}) {
    ImageFile image;
    image.frame_id = id;
    image.held_out = id == 4;
    camera.images.push_back(image);
    recording.frames.push_back({id, id * 1'000'000'007, turned(0.3 * double(id), double(id))});
    recording.box_files.push_back({id, "boxes"});
  }
  recording.cameras.push_back(camera);
  recording.lidars.push_back({"top", turned(0.2, 1), 0.003, 1.7});
  for (const std::size_t cell : {40, 41}) recording.lidars[0].blind.insert(cell);
  recording.reader = std::make_shared<TwoBoxes>();
  return recording;
}

TEST(RecordingJson, BringsBackEveryBit) {
  const TemporaryFolder folder;
  const Recording before = recorded();
  write_file(folder.path / "recording.json", recording_to_json(before));
  const Recording after = read_recording_json(folder.path / "recording.json");
  EXPECT_EQ(after.format, "kitti");
  EXPECT_EQ(after.global_frame, GlobalFrame::kArbitrary);
  ASSERT_EQ(after.frames.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(after.frames[i].t_ns, before.frames[i].t_ns);
    EXPECT_EQ(after.frames[i].global_from_body.matrix(),
              before.frames[i].global_from_body.matrix());
    EXPECT_EQ(after.cameras[0].images[i].frame_id, before.cameras[0].images[i].frame_id);
    EXPECT_EQ(after.cameras[0].images[i].held_out, i == 1);
    const std::vector<Box> boxes = after.reader->read_boxes(after.box_files.at(i)),
                           were = before.reader->read_boxes(before.box_files[i]);
    ASSERT_EQ(boxes.size(), 2u);
    EXPECT_EQ(boxes[1].object_id, 8);
    EXPECT_EQ(boxes[1].t_ns, were[1].t_ns);
    EXPECT_EQ(boxes[1].body_from_box.matrix(), were[1].body_from_box.matrix());
    EXPECT_EQ(boxes[1].size_m, were[1].size_m);
    EXPECT_EQ(boxes[1].velocity_in_body_m_per_s, were[1].velocity_in_body_m_per_s);
  }
  const CameraCalibration &camera = after.cameras[0].calibration,
                          &was = before.cameras[0].calibration;
  EXPECT_EQ(camera.parameters, was.parameters);
  EXPECT_EQ(camera.body_from_sensor.matrix(), was.body_from_sensor.matrix());
  EXPECT_EQ(camera.time_offset_ns, was.time_offset_ns);
  EXPECT_EQ(camera.readout_ns, was.readout_ns);
  EXPECT_EQ(camera.readout_by_column, was.readout_by_column);
  EXPECT_EQ(after.lidars.at(0).body_from_lidar.matrix(), before.lidars[0].body_from_lidar.matrix());
  EXPECT_EQ(after.lidars[0].elevation_rad, 0.003);
  EXPECT_EQ(after.lidars[0].gain, 1.7);
  EXPECT_EQ(after.lidars[0].blind.runs(), (std::vector<BlindDirections::Run>{{40, 2}}));
}

TEST(RecordingJson, NamesFileFieldAndValue) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path / "recording.json";
  const nlohmann::json whole = nlohmann::json::parse(recording_to_json(recorded()));
  const std::vector<std::tuple<const char*, nlohmann::json, const char*>> cases = {
      {"/cameras/0/model", "mey", "cameras[0].model"},
      {"/lidars/0/blind/0/1", 200000, "lidars[0].blind[0]"},
      {"/cameras/0/parameters/9", 1e9, "cameras[0].parameters[9]"},
      {"/cameras/0/readout_ns", 1e18, "readout_ns"},
      {"/frames/1/t_ns", 5, "frames[1].t_ns"},
      {"/frames/1/global_from_body/0", 7, "frames[1].global_from_body"},
      {"/boxes/0/size_m", {1, 2}, "boxes[0].size_m"},
      {"/lidars", 3, "lidars"},
      {"/ecef", "yes", "ecef"}};
  for (const auto& [pointer, value, field] : cases) {
    nlohmann::json changed = whole;
    changed[nlohmann::json::json_pointer(pointer)] = value;
    write_file(file, changed.dump());
    EXPECT_THAT(input_error([&] { read_recording_json(file); }), HasSubstr(field));
  }
}

}  // namespace
}  // namespace redrive
