// SPDX-License-Identifier: Apache-2.0
#include "tools/analytic/recording_writer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/image/image_io.h"
#include "redrive/math/wgs84.h"

namespace redrive::analytic {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using nlohmann::json;

constexpr double kFrameInterval_s = 1.0 / 15, kSpeed_m_s = 5, kFirstTime_s = 1000;
constexpr int kSupersampling = 4;  // per axis

double radians(double degrees) { return degrees * M_PI / 180; }

// Camera axes (x right, y down, z forward) in body axes for a camera that looks along `yaw`,
// pitched down.
Rigid3d extrinsic(const Vector3d& position, double yaw_deg, double pitch_down_deg,
                  double roll_deg) {
  Matrix3d body_from_forward_camera;
  body_from_forward_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  Rigid3d body_from_sensor = Rigid3d::Identity();
  body_from_sensor.linear() =
      Eigen::AngleAxisd(radians(yaw_deg), Vector3d::UnitZ()).toRotationMatrix() *
      body_from_forward_camera *
      Eigen::AngleAxisd(radians(-pitch_down_deg), Vector3d::UnitX()).toRotationMatrix() *
      Eigen::AngleAxisd(radians(roll_deg), Vector3d::UnitZ()).toRotationMatrix();
  body_from_sensor.translation() = position;
  return body_from_sensor;
}

json matrix_json(const Rigid3d& transform) {
  json rows = json::array();
  for (int r = 0; r < 4; ++r) {
    json row = json::array();
    for (int c = 0; c < 4; ++c) row.push_back(transform.matrix()(r, c));
    rows.push_back(row);
  }
  return rows;
}

json camera_json(const CameraCalibration& camera) {
  const Vector3d position = camera.body_from_sensor.translation();
  json entry = {{"sensor_type", "camera"},
                {"label", camera.name},
                {"model", camera.model},
                {"focal_length_px", {camera.fx(), camera.fy()}},
                {"principal_point_px", {camera.cx(), camera.cy()}},
                {"image_resolution_px", {camera.width, camera.height}},
                {"distortion_coeffs", distortion(camera)},
                {"RT_body_from_sensor", matrix_json(camera.body_from_sensor)},
                {"RT_sensor_from_body", matrix_json(camera.body_from_sensor.inverse())},
                {"pos_meter", {position.x(), position.y(), position.z()}}};
  for (const auto& [name, value] : other_parameters(camera)) entry[name] = value;
  return entry;
}

std::string image_name(const std::string& camera, std::int64_t id, const char* suffix) {
  char text[32];
  std::snprintf(text, sizeof text, "_%07lld%s", static_cast<long long>(id), suffix);
  return camera + text;
}

struct NovelShift {
  const char* name;
  Vector3d shift_body_m;
};
const NovelShift kNovelShifts[] = {{"left_0.5", {0, 0.5, 0}},
                                   {"left_1", {0, 1, 0}},
                                   {"right_0.5", {0, -0.5, 0}},
                                   {"right_1", {0, -1, 0}},
                                   {"forward_0.5", {0.5, 0, 0}}};
constexpr std::array kNovelCameras = {"F_MIDLONGRANGECAM_CL", "M_FISHEYE_L"};
constexpr int kNovelFrames = 3;

void write_novel(const std::filesystem::path& folder, const NovelShift& novel,
                 const Courtyard& scene, const std::vector<CameraCalibration>& rig,
                 const DriveOptions& options, ThreadPool& pool) {
  std::filesystem::create_directories(folder);
  json images = json::array();
  for (const CameraCalibration& calibration : rig) {
    if (std::find(kNovelCameras.begin(), kNovelCameras.end(), calibration.name) ==
        kNovelCameras.end())
      continue;
    for (int k = 0; k < kNovelFrames; ++k) {
      const int index = (2 * k + 1) * options.frames / (2 * kNovelFrames);
      const std::int64_t id = options.first_id + index;
      Rigid3d shifted = world_from_body(index);
      shifted.translate(novel.shift_body_m);
      const CapturedImage captured = capture_image(scene, make_camera(calibration),
                                                   shifted * calibration.body_from_sensor, pool);
      const std::string file = image_name(calibration.name, id, ".jpg");
      write_image(folder / file, captured.image);
      write_png16(folder / image_name(calibration.name, id, "_depth.png"),
                  {calibration.width, calibration.height, captured.depth_mm});
      images.push_back(
          {{"file", file},
           {"camera", calibration.name},
           {"frame_id", id},
           {"RT_ECEF_body", matrix_json(global_from_world() * shifted)},
           {"shift_body_m",
            {novel.shift_body_m.x(), novel.shift_body_m.y(), novel.shift_body_m.z()}}});
    }
  }
  write_file(folder / "poses.json", json{{"images", images}}.dump(1));
}

}  // namespace

std::vector<CameraCalibration> rig_calibration() {
  std::vector<CameraCalibration> rig(4);
  rig[0] = {"F_MIDLONGRANGECAM_CL",
            "opencv_pinhole",
            {438, 376, 240.5, 131, -0.30, 0.084, 0.002, 0.0006, 0},
            480,
            264,
            extrinsic({1.9, 0.1, 1.25}, 0.4, 2.0, 0.2)};
  rig[1] = {"B_MIDRANGECAM_C",
            "opencv_pinhole",
            {242, 243.5, 240, 152, -0.33, 0.10, -0.001, 0.0013, 0},
            480,
            304,
            extrinsic({0.05, 0, 1.37}, 179.2, 1.0, -0.3)};
  rig[2] = {"M_FISHEYE_L", "mei", {216, 188, 240.7, 129.3, 0.034, -0.084, 0, 0, 0, 1.02},
            480,           264,   extrinsic({1.05, 0.64, 1.41}, 91.0, 18.0, 0.5)};
  rig[3] = {"M_FISHEYE_R", "mei", {216.5, 188.6, 241.4, 129.4, 0.027, -0.081, 0, 0, 0, 1.017},
            480,           264,   extrinsic({1.05, -0.64, 1.41}, -89.5, 18.5, -0.4)};
  return rig;
}

Rigid3d world_from_body(int index) {
  // Heading psi(s) = 0.12 sin(s / 4), s the distance driven; position by Simpson's rule on the
  // heading.
  const double distance = kSpeed_m_s * kFrameInterval_s * index;
  const auto heading = [](double s) { return 0.12 * std::sin(s / 4); };
  Vector3d position = Vector3d::Zero();
  constexpr int kPanels = 64;
  const double panel = distance / kPanels;
  for (int i = 0; i < kPanels; ++i) {
    const double a = heading(i * panel), m = heading((i + 0.5) * panel),
                 b = heading((i + 1) * panel);
    position.x() += panel / 6 * (std::cos(a) + 4 * std::cos(m) + std::cos(b));
    position.y() += panel / 6 * (std::sin(a) + 4 * std::sin(m) + std::sin(b));
  }
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::AngleAxisd(heading(distance), Vector3d::UnitZ()).toRotationMatrix();
  pose.translation() = position;
  return pose;
}

Rigid3d global_from_world() {
  const double latitude = radians(47.5), longitude = radians(19.0), height_m = 150,
               heading = radians(35);
  constexpr double e2 = kWgs84EccentricitySquared;
  const double normal_radius =
      kWgs84SemiMajor_m / std::sqrt(1 - e2 * std::sin(latitude) * std::sin(latitude));
  const Vector3d east(-std::sin(longitude), std::cos(longitude), 0);
  const Vector3d up(std::cos(latitude) * std::cos(longitude),
                    std::cos(latitude) * std::sin(longitude), std::sin(latitude));
  const Vector3d north = up.cross(east);
  Rigid3d pose = Rigid3d::Identity();
  pose.linear().col(0) = std::cos(heading) * north + std::sin(heading) * east;
  pose.linear().col(2) = up;
  pose.linear().col(1) = up.cross(pose.linear().col(0));
  pose.translation() =
      (normal_radius + height_m) * up - Vector3d(0, 0, e2 * normal_radius * std::sin(latitude));
  return pose;
}

CapturedImage capture_image(const Courtyard& scene, const Camera& camera,
                            const Rigid3d& world_from_camera, ThreadPool& pool) {
  CapturedImage captured;
  captured.image = {camera.width, camera.height,
                    std::vector<std::uint8_t>(3u * camera.width * camera.height)};
  captured.depth_mm.resize(std::size_t(camera.width) * camera.height);
  const auto see = [&](double x, double y) -> std::optional<RayColour> {
    const auto direction = camera.unproject({x, y});
    if (!direction) return std::nullopt;
    return trace(scene, world_from_camera.translation(), world_from_camera.linear() * *direction);
  };
  pool.run(camera.height, [&](int y) {
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t pixel = std::size_t(y) * camera.width + x;
      const auto center = see(x, y);
      if (!center) continue;
      captured.depth_mm[pixel] = static_cast<std::uint16_t>(
          std::clamp(std::lround(1000 * center->distance_m), 0l, 65535l));
      Vector3d sum = Vector3d::Zero();
      int seen = 0;
      for (int i = 0; i < kSupersampling * kSupersampling; ++i) {
        const double dx = (i % kSupersampling + 0.5) / kSupersampling - 0.5,
                     dy = (i / kSupersampling + 0.5) / kSupersampling - 0.5;
        if (const auto sample = see(x + dx, y + dy)) sum += sample->colour, ++seen;
      }
      for (int k = 0; k < 3; ++k)
        captured.image.rgb[3 * pixel + k] = static_cast<std::uint8_t>(
            std::lround(255 * (seen ? sum[k] / seen : center->colour[k])));
    }
  });
  return captured;
}

void write_recording(const std::filesystem::path& root, const DriveOptions& options,
                     ThreadPool& pool) {
  if (std::filesystem::exists(root))
    throw UsageError("OUT", root.string(), "exists; nothing is overwritten");
  const Courtyard scene = make_courtyard(options.seed);
  const std::vector<CameraCalibration> rig = rig_calibration();
  json calibration = {
      {"Imu0", {{"sensor_type", "imu"}, {"label", "Imu0"}, {"pos_meter", {0, 0, 0}}}}};
  for (const CameraCalibration& camera : rig) {
    calibration[camera.name] = camera_json(camera);
    std::filesystem::create_directories(root / "sensor/camera" / camera.name);
  }
  std::filesystem::create_directories(root / "sensor/calibration");
  std::filesystem::create_directories(root / "sensor/gnssins");
  write_file(root / "sensor/calibration/calibration.json", calibration.dump(1));

  json egomotion = json::object();
  for (int index = 0; index < options.frames; ++index) {
    const std::int64_t id = options.first_id + index;
    const double time_s = kFirstTime_s + kFrameInterval_s * index;
    egomotion[std::to_string(id)] = {
        {"RT_ECEF_body", matrix_json(global_from_world() * world_from_body(index))},
        {"time", time_s},
        {"time_host", time_s}};
    for (const CameraCalibration& camera : rig) {
      const CapturedImage captured = capture_image(
          scene, make_camera(camera), world_from_body(index) * camera.body_from_sensor, pool);
      write_image(root / "sensor/camera" / camera.name / image_name(camera.name, id, ".jpg"),
                  captured.image);
    }
  }
  write_file(root / "sensor/gnssins/egomotion2.json", egomotion.dump(1));
  for (const NovelShift& novel : kNovelShifts)
    write_novel(root / "novel" / novel.name, novel, scene, rig, options, pool);
}

}  // namespace redrive::analytic
