// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_calibration.h"

#include <algorithm>
#include <charconv>

#include "redrive/base/error.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/parse/rigid_json.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive::kitti {
namespace {

constexpr double kMaxApart_m = 50;
constexpr int kCameras = 4;

/// The cameras P0 to P3 of a benchmark's calibration.
RectifiedCameras numbered_cameras(const JsonField& root) {
  RectifiedCameras cameras;
  for (int c = 0; c < kCameras; ++c)
    if (const std::string name = "P" + std::to_string(c); root.has(name))
      cameras[c] = camera_from_projection(root.at(name), std::nullopt);
  return cameras;
}

/// The 3 x 4 matrix of a field.
Rigid3d rigid_from_rows(const JsonField& field, const std::string& name,
                        const std::filesystem::path& file) {
  const std::vector<double> m = field.numbers(12);
  return rigid_from_numbers({m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]},
                            {m[3], m[7], m[11]}, name, file);
}

}  // namespace

nlohmann::json value_of(std::string_view word) {
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error == std::errc() && end == word.data() + word.size() && std::isfinite(value))
    return value;
  return std::string(word);  // calib_time, or a fault that the field's reader names
}

nlohmann::json key_values(std::string_view text, const std::filesystem::path& file,
                          bool needs_colon) {
  nlohmann::json document = nlohmann::json::object();
  for (const TextLine& line : text_lines(text, file)) {
    if (line.size() == 0) continue;
    std::string key(line.word(0));
    if (key.size() >= 2 && key.back() == ':')
      key.pop_back();
    else if (needs_colon)
      line.fail(0, "key", "expected \"KEY: numbers\" in each line");
    if (document.contains(key)) line.fail(0, "key", "stands in an earlier line, too");
    nlohmann::json values = nlohmann::json::array();
    for (std::size_t i = 1; i < line.size(); ++i) values.push_back(value_of(line.word(i)));
    document[key] = std::move(values);
  }
  return document;
}

Rigid3d rigid_from_numbers(const std::vector<double>& rotation,
                           const std::vector<double>& translation, const std::string& name,
                           const std::filesystem::path& file) {
  nlohmann::json rows = nlohmann::json::array();
  for (std::size_t r = 0; r < 3; ++r)
    rows.push_back({rotation[3 * r], rotation[3 * r + 1], rotation[3 * r + 2], translation[r]});
  rows.push_back({0, 0, 0, 1});
  const nlohmann::json document = {{name, rows}};
  const JsonField field = JsonField(document, file).at(name);
  const Rigid3d rigid = rigid_from_json(field);
  if (!(rigid.translation().norm() <= kMaxApart_m))
    field.fail("sensors are more than 50 m apart; metres are expected");
  return rigid;
}

RectifiedCamera camera_from_projection(const JsonField& field, std::optional<ImageSize> size) {
  const std::vector<double> p = field.numbers(12);
  if (p[1] != 0 || p[4] != 0 || p[8] != 0 || p[9] != 0 || p[10] != 1)
    field.fail("expected the projection of a rectified image: fx 0 cx, 0 fy cy, 0 0 1");
  RectifiedCamera camera;
  camera.fx = focal_length_from_json(field.at(std::size_t{0}));
  camera.fy = focal_length_from_json(field.at(std::size_t{5}));
  camera.cx = p[2], camera.cy = p[6];
  if (size) {
    principal_point_from_json(field.at(std::size_t{2}), size->width);
    principal_point_from_json(field.at(std::size_t{6}), size->height);
  }
  camera.size = size;
  const Eigen::Vector3d t((p[3] - camera.cx * p[11]) / camera.fx,
                          (p[7] - camera.cy * p[11]) / camera.fy, p[11]);
  if (!(t.norm() <= kMaxApart_m))
    field.fail("places the camera more than 50 m from camera 0; metres are expected");
  camera.camera_from_rectified.translation() = t;
  return camera;
}

ImageSize size_from_json(const JsonField& field) {
  field.numbers(2);
  CameraCalibration sized;
  image_size_from_json(field.at(std::size_t{0}), field.at(std::size_t{1}), &sized);
  return {sized.width, sized.height};
}

CamToCam parse_cam_to_cam(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = key_values(text, file);
  const JsonField root(document, file);
  CamToCam calibration;
  calibration.rectified_from_camera =
      rigid_from_numbers(root.at("R_rect_00").numbers(9), {0, 0, 0}, "R_rect_00", file);
  for (int c = 0; c < kCameras; ++c) {
    const std::string number = "0" + std::to_string(c);
    if (!root.has("P_rect_" + number)) continue;
    calibration.cameras[c] = camera_from_projection(root.at("P_rect_" + number),
                                                    size_from_json(root.at("S_rect_" + number)));
  }
  return calibration;
}

OdometryCalibration parse_odometry_calibration(std::string_view text,
                                               const std::filesystem::path& file) {
  const nlohmann::json document = key_values(text, file);
  const JsonField root(document, file);
  OdometryCalibration calibration{numbered_cameras(root), std::nullopt};
  if (root.has("Tr"))
    calibration.rectified_from_velodyne = rigid_from_rows(root.at("Tr"), "Tr", file);
  return calibration;
}

TrackingCalibration parse_tracking_calibration(std::string_view text,
                                               const std::filesystem::path& file) {
  const nlohmann::json document = key_values(text, file, /*needs_colon=*/false);
  const JsonField root(document, file);
  const auto key = [&](const char* name, const char* of_detection) -> std::string {
    for (const char* each : {name, of_detection})
      if (root.has(each)) return each;
    throw InputError(file, name, "",
                     "missing; a calibration of KITTI's tracking benchmark has P0 to P3, R_rect, "
                     "Tr_velo_cam and Tr_imu_velo");
  };
  const auto rigid = [&](const std::string& name) {
    return rigid_from_rows(root.at(name), name, file);
  };
  const std::string turn = key("R_rect", "R0_rect");
  return {numbered_cameras(root),
          rigid_from_numbers(root.at(turn).numbers(9), {0, 0, 0}, turn, file),
          rigid(key("Tr_velo_cam", "Tr_velo_to_cam")), rigid(key("Tr_imu_velo", "Tr_imu_to_velo"))};
}

Rigid3d parse_rigid(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = key_values(text, file);
  const JsonField root(document, file);
  const std::vector<double> rotation = root.at("R").numbers(9);
  return rigid_from_numbers(rotation, root.at("T").numbers(3), "R, T", file);
}

}  // namespace redrive::kitti
