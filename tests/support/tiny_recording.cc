// SPDX-License-Identifier: Apache-2.0
#include "tests/support/tiny_recording.h"

#include <cmath>
#include <cstdio>

#include "redrive/base/files/files.h"
#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"

namespace redrive::testing {
namespace {

namespace fs = std::filesystem;

nlohmann::json rows(const Rigid3d& transform) {
  nlohmann::json matrix = nlohmann::json::array();
  for (int r = 0; r < 4; ++r) {
    matrix.push_back(nlohmann::json::array());
    for (int c = 0; c < 4; ++c) matrix.back().push_back(transform.matrix()(r, c));
  }
  return matrix;
}

/// A level camera whose optical axis points along `forward` (body axes) at 1.5 m height.
Rigid3d level_camera(const Eigen::Vector3d& forward, const Eigen::Vector3d& position) {
  const Eigen::Vector3d down(0, 0, -1);
  Rigid3d body_from_sensor = Rigid3d::Identity();
  body_from_sensor.linear() << down.cross(forward), down, forward;
  body_from_sensor.translation() = position;
  return body_from_sensor;
}

std::vector<CameraCalibration> cameras() {
  return {{kTinyRear,
           "opencv_pinhole",
           {30, 28, 19.5, 11.5, -0.05, 0.01, 0, 0, 0},
           40,
           24,
           level_camera({-1, 0, 0}, {-1, 0, 1.5})},
          {kTinyFront,
           "opencv_pinhole",
           {44, 38, 24, 15, -0.2, 0.05, 0.001, 0.0005, 0},
           48,
           32,
           level_camera({1, 0, 0}, {2, 0.1, 1.5})},
          {kTinyLeft,
           "mei",
           {20, 18, 21.5, 17, 0.03, -0.08, 0, 0, 0, 1.02},
           44,
           36,
           level_camera({0, 1, 0}, {1, 0.6, 1.5})}};
}

Rigid3d global_from_body(int frame) {
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  pose.translation() = Eigen::Vector3d(4081775.25, 1405467.5, 4679608.75);
  return pose * Eigen::Translation3d(0.2 * frame, 0, 0);
}

Image8 render_sphere(const CameraCalibration& calibration) {
  const Camera camera = make_camera(calibration);
  Image8 image{camera.width, camera.height, {}};
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto direction = camera.unproject({double(x), double(y)});
      for (int k = 0; k < 3; ++k) {
        const double component =
            direction ? (calibration.body_from_sensor.linear() * *direction)((k + 1) % 3) : 0;
        image.rgb.push_back(static_cast<std::uint8_t>(
            std::lround(255 * (0.5 + 0.4 * std::sin(3 * component + k)))));
      }
    }
  return image;
}

}  // namespace

fs::path tiny_calibration(const fs::path& root) {
  return root / "sensor/calibration/calibration.json";
}
fs::path tiny_egomotion(const fs::path& root) { return root / "sensor/gnssins/egomotion2.json"; }

fs::path tiny_image(const fs::path& root, const std::string& camera, int id) {
  char name[32];
  std::snprintf(name, sizeof name, "_%07d.jpg", id);
  return root / "sensor/camera" / camera / (camera + name);
}

void write_tiny_recording(const fs::path& root) {
  nlohmann::json calibration = {{"Imu0", {{"sensor_type", "imu_ins"}}}}, egomotion;
  for (const CameraCalibration& camera : cameras()) {
    const Eigen::Vector3d position = camera.body_from_sensor.translation();
    calibration[camera.name] = {{"sensor_type", "camera"},
                                {"model", camera.model},
                                {"focal_length_px", {camera.fx(), camera.fy()}},
                                {"principal_point_px", {camera.cx(), camera.cy()}},
                                {"image_resolution_px", {camera.width, camera.height}},
                                {"distortion_coeffs", distortion(camera)},
                                {"RT_body_from_sensor", rows(camera.body_from_sensor)},
                                {"RT_sensor_from_body", rows(camera.body_from_sensor.inverse())},
                                {"pos_meter", {position.x(), position.y(), position.z()}}};
    for (const auto& [name, value] : other_parameters(camera))
      calibration[camera.name][name] = value;
    const Image8 image = render_sphere(camera);
    for (int frame = 0; frame < kTinyFrames; ++frame) {
      const fs::path file = tiny_image(root, camera.name, kTinyFirstId + frame);
      fs::create_directories(file.parent_path());
      write_image(file, image);
    }
  }
  for (int frame = 0; frame < kTinyFrames; ++frame)
    egomotion[std::to_string(kTinyFirstId + frame)] = {
        {"RT_ECEF_body", rows(global_from_body(frame))}, {"time_host", 4833.0 + frame / 15.0}};
  fs::create_directories(tiny_calibration(root).parent_path());
  fs::create_directories(tiny_egomotion(root).parent_path());
  write_file(tiny_calibration(root), calibration.dump(1));
  write_file(tiny_egomotion(root), egomotion.dump(1));
}

void edit_json(const fs::path& file, const std::function<void(nlohmann::json&)>& change) {
  nlohmann::json json = read_json(file);
  change(json);
  write_file(file, json.dump(1));
}

}  // namespace redrive::testing
