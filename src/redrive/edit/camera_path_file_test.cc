// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/camera_path_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

// At (1, 2, 3), looking along the world's x axis, z up: columns right, up, backward, position.
nlohmann::json nerfstudio_path() {
  return nlohmann::json::parse(R"({
    "camera_type": "perspective", "render_width": 640, "render_height": 360, "fps": 30,
    "seconds": 2.5, "smoothness_value": 0.5, "is_cycle": false, "crop": null,
    "keyframes": [{"matrix": "[1]", "fov": 50, "aspect": 1.7}],
    "camera_path": [
      {"camera_to_world": [0, 0, -1, 1, -1, 0, 0, 2, 0, 1, 0, 3, 0, 0, 0, 1], "fov": 60,
       "aspect": 1.78},
      {"camera_to_world": [[0, 0, -1, 5], [-1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]], "fov": 50}
    ]})");
}

nlohmann::json our_path() {
  return nlohmann::json::parse(R"({"keyframes": [
    {"time_s": 0.5, "camera": "CAM", "frame_id": 7},
    {"time_s": 2, "camera": "CAM", "frame_id": 9, "shift_body_m": [0, 1.5, 0], "yaw_deg": -20,
     "pitch_deg": 3}]})");
}

CameraPathFile parse(const nlohmann::json& json) {
  return parse_camera_path(json.dump(), "path.json");
}

TEST(CameraPathFile, ReadsNerfstudiosLayout) {
  const CameraPathFile path = parse(nerfstudio_path());
  EXPECT_EQ(path.width, 640);
  EXPECT_EQ(path.height, 360);
  EXPECT_EQ(path.fps, 30);
  EXPECT_EQ(path.seconds, 2.5);
  EXPECT_FALSE(path.fisheye);
  EXPECT_TRUE(path.keyframes.empty());
  ASSERT_EQ(path.cameras.size(), 2u);
  EXPECT_EQ(path.cameras[0].fov_deg, 60);
  const Rigid3d& pose = path.cameras[0].world_from_camera;
  EXPECT_EQ(pose.translation(), Eigen::Vector3d(1, 2, 3));
  EXPECT_TRUE(pose.linear().col(0).isApprox(Eigen::Vector3d(0, -1, 0))) << "right";
  EXPECT_TRUE(pose.linear().col(1).isApprox(Eigen::Vector3d(0, 0, -1))) << "down";
  EXPECT_TRUE(pose.linear().col(2).isApprox(Eigen::Vector3d(1, 0, 0))) << "forward";
  EXPECT_EQ(path.cameras[1].world_from_camera.translation(), Eigen::Vector3d(5, 2, 3));
  EXPECT_EQ(camera_to_world_json(pose), nerfstudio_path()["camera_path"][0]["camera_to_world"]);
}

TEST(CameraPathFile, FollowsItsOwnKeyframes) {
  const CameraPathFile path = parse(our_path());
  EXPECT_TRUE(path.cameras.empty());
  EXPECT_EQ(path.fps, 24);
  EXPECT_EQ(path.seconds, 1.5);
  ASSERT_EQ(path.keyframes.size(), 2u);
  EXPECT_EQ(path.keyframes[1].frame_id, 9);
  EXPECT_EQ(path.keyframes[1].shift_body_m, (std::array<double, 3>{0, 1.5, 0}));
  EXPECT_EQ(path.keyframes[1].yaw_deg, -20);
  nlohmann::json again;
  for (const PathKeyframe& key : path.keyframes)
    again["keyframes"].push_back(path_keyframe_to_json(key));
  EXPECT_EQ(parse(again).keyframes[1].pitch_deg, 3);
}

TEST(CameraPathFile, ErrorsNameFileFieldAndValue) {
  const auto expect_error = [](nlohmann::json json, const char* at, const nlohmann::json& value,
                               const char* field) {
    json[nlohmann::json::json_pointer(at)] = value;
    try {
      parse(json);
      FAIL() << at << " = " << value << " was taken";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), ::testing::StartsWith(std::string("path.json: ") + field));
    }
  };
  const nlohmann::json theirs = nerfstudio_path(), ours = our_path();
  expect_error(theirs, "/fps", 0, "fps = 0");
  expect_error(theirs, "/seconds", -1, "seconds = -1");
  expect_error(theirs, "/camera_type", "equirectangular", "camera_type = \"equirectangular\"");
  expect_error(theirs, "/render_width", 1e9, "render_width = 1000000000");
  expect_error(theirs, "/render_height", 1, "render_height = 1");
  expect_error(theirs, "/camera_path", nlohmann::json::array(), "camera_path = []");
  expect_error(theirs, "/camera_path/1/fov", 180, "camera_path[1].fov = 180");
  expect_error(theirs, "/camera_path/0/camera_to_world/0", 1, "camera_path[0].camera_to_world");
  expect_error(theirs, "/camera_path/0/camera_to_world/3", 1e8, "camera_path[0].camera_to_world");
  expect_error(ours, "/keyframes/1/time_s", 0.5, "keyframes[1].time_s = 0.5");
  expect_error(ours, "/keyframes/1/shift_body_m", {0, 2e4, 0}, "keyframes[1].shift_body_m[1]");
  expect_error(ours, "/keyframes/1/yaw_deg", 400, "keyframes[1].yaw_deg = 400");
  expect_error(ours, "/keyframes/0/frame_id", -1, "keyframes[0].frame_id = -1");
  expect_error(ours, "/keyframes/0/camera", "", "keyframes[0].camera");
  expect_error(ours, "/keyframes/1", 3, "keyframes[1]");
  EXPECT_THROW(parse_camera_path("{", "path.json"), InputError);
  EXPECT_THROW(parse_camera_path("{}", "path.json"), InputError);
}

}  // namespace
}  // namespace redrive
