// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/camera_path_file.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/edit/view_requests.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive {
namespace {

constexpr double kMaxPosition_m = 1e7;  // photographs may have ECEF coordinates

int side(const JsonField& field) {
  return static_cast<int>(number_within(field, 2, 16384, "expected pixels, 2 to 16384"));
}

PathCamera path_camera_from_json(const JsonField& entry) {
  const JsonField field = entry.at("camera_to_world");
  Eigen::Matrix4d matrix;
  if (field.json().is_array() && field.size() == 16) {
    const std::vector<double> numbers = field.numbers(16);
    matrix = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(numbers.data());
  } else {
    matrix = field.matrix4();
  }
  if (const std::string obstacle = rigid_obstacle(matrix); !obstacle.empty())
    field.fail("expected a rigid transform: " + obstacle);
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::Quaterniond(matrix.topLeftCorner<3, 3>()).normalized().toRotationMatrix();
  pose.translation() = matrix.topRightCorner<3, 1>();
  if (pose.translation().lpNorm<Eigen::Infinity>() > kMaxPosition_m)
    field.fail("expected metres in the run's world, at most 1e7 along each axis");
  return {photographs::with_opengl_axes(pose),
          number_within(entry.at("fov"), 1, 179, "expected the vertical angle, 1 to 179 degrees")};
}

void read_cameras(const JsonField& root, CameraPathFile* path) {
  if (root.has("camera_type")) {
    const JsonField type = root.at("camera_type");
    const std::string name = type.string();
    if (name != "perspective" && name != "fisheye") type.fail("expected perspective or fisheye");
    path->fisheye = name == "fisheye";
  }
  path->width = side(root.at("render_width"));
  path->height = side(root.at("render_height"));
  const JsonField list = root.at("camera_path");
  if (!list.json().is_array() || list.size() == 0 || list.size() > kMaxPathCameras)
    list.fail("expected a list of 1 to 100000 cameras");
  for (std::size_t i = 0; i < list.size(); ++i)
    path->cameras.push_back(path_camera_from_json(list.at(i)));
  path->seconds = static_cast<double>(path->cameras.size()) / path->fps;
}

}  // namespace

std::vector<PathKeyframe> path_keyframes_from_json(const JsonField& list) {
  if (!list.json().is_array() || list.size() == 0 || list.size() > kMaxPathKeyframes)
    list.fail("expected a list of 1 to 256 keyframes");
  std::vector<PathKeyframe> keyframes;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonField entry = list.at(i);
    PathKeyframe key;
    key.camera = entry.at("camera").string();
    if (key.camera.empty() || key.camera.size() > 256)
      entry.at("camera").fail("expected a name of at most 256 characters");
    key.frame_id = entry.at("frame_id").integer();
    if (key.frame_id < 0) entry.at("frame_id").fail("expected a frame id, >= 0");
    if (entry.has("shift_body_m")) {
      key.shift_body_m =
          numbers_within<3>(entry.at("shift_body_m"), -kMaxShift_m, kMaxShift_m,
                            "expected three numbers: metres, at most 1e4 along each axis");
    }
    const auto angle = [&](const char* name) {
      return entry.has(name)
                 ? number_within(entry.at(name), -360, 360, "expected degrees, -360 to 360")
                 : 0.0;
    };
    key.yaw_deg = angle("yaw_deg");
    key.pitch_deg = angle("pitch_deg");
    key.time_s = number_within(entry.at("time_s"), 0, kMaxPath_s, "expected seconds, 0 to 3600");
    if (i > 0 && !(key.time_s - keyframes.back().time_s >= 1e-3))
      entry.at("time_s").fail("expected times that increase by 0.001 s at least");
    keyframes.push_back(std::move(key));
  }
  return keyframes;
}

nlohmann::json path_keyframe_to_json(const PathKeyframe& keyframe) {
  return {{"time_s", keyframe.time_s},     {"camera", keyframe.camera},
          {"frame_id", keyframe.frame_id}, {"shift_body_m", keyframe.shift_body_m},
          {"yaw_deg", keyframe.yaw_deg},   {"pitch_deg", keyframe.pitch_deg}};
}

nlohmann::json camera_to_world_json(const Rigid3d& world_from_camera) {
  const Eigen::Matrix4d matrix = photographs::with_opengl_axes(world_from_camera).matrix();
  nlohmann::json numbers = nlohmann::json::array();
  for (int i = 0; i < 16; ++i) numbers.push_back(matrix(i / 4, i % 4));
  return numbers;
}

CameraPathFile parse_camera_path(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  CameraPathFile path;
  path.path = file;
  if (root.has("fps"))
    path.fps = number_within(root.at("fps"), kMinPathFps, kMaxPathFps,
                             "expected images a second, 1 to 240");
  const bool has_keyframes = root.has("keyframes") && root.at("keyframes").json().is_array() &&
                             root.at("keyframes").size() > 0 &&
                             root.at("keyframes").at(0).has("frame_id");
  if (has_keyframes) {
    path.keyframes = path_keyframes_from_json(root.at("keyframes"));
    path.seconds = path.keyframes.back().time_s - path.keyframes.front().time_s;
  } else {
    read_cameras(root, &path);
  }
  if (root.has("seconds"))
    path.seconds = number_within(root.at("seconds"), 0, kMaxPath_s, "expected seconds, 0 to 3600");
  return path;
}

CameraPathFile read_camera_path(const std::filesystem::path& file) {
  return parse_camera_path(read_file(file), file);
}

}  // namespace redrive
