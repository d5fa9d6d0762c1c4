// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/calibration_json.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/math/angles.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/parse/json_numbers.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

constexpr double kMaxSensorDistance_m = 50;  // further from the body's origin: not in metres
constexpr double kMaxTimeOffset_s = 1;       // beyond: another frame's image
constexpr const char *kElevation = "elevation_offset_deg", *kByColumn = "readout_by_column";
constexpr double kMaxElevation_deg = 2;        // beyond: not an error of a calibration
constexpr double kPositionTolerance_m = 0.01;  // rounding of pos_meter and RT in files

bool usable_name(const std::string& name) {
  const auto plain = [](unsigned char c) {
    return std::isalnum(c) || c == '_' || c == '-' || c == '.';
  };
  return !name.empty() && name.size() <= 128 && name[0] != '.' &&
         std::all_of(name.begin(), name.end(), plain);
}

bool has_text_type(const JsonField& sensor) {
  return sensor.has("sensor_type") && sensor.at("sensor_type").json().is_string();
}
bool has_type(const JsonField& sensor, const char* type) {
  return has_text_type(sensor) && sensor.at("sensor_type").string() == type;
}

bool is_camera(const JsonField& sensor) {
  if (has_text_type(sensor)) return has_type(sensor, "camera");
  return sensor.has("model") && sensor.has("focal_length_px");
}

[[noreturn]] void refuse(const JsonField& field, const std::string& value,
                         const std::string& rule) {
  throw InputError(field.file(), field.field(), value, rule);
}

std::string text(const Eigen::Vector3d& v) {
  char buffer[96];
  std::snprintf(buffer, sizeof buffer, "(%.3f, %.3f, %.3f)", v.x(), v.y(), v.z());
  return buffer;
}

Rigid3d extrinsics_from_json(const JsonField& sensor) {
  const Rigid3d body_from_sensor = rigid_from_json(sensor.at("RT_body_from_sensor"));
  if (body_from_sensor.translation().norm() > kMaxSensorDistance_m) {
    refuse(sensor.at("RT_body_from_sensor"), "translation " + text(body_from_sensor.translation()),
           "the sensor is more than 50 m from the body's origin; metres are expected");
  }
  return body_from_sensor;
}

// InputError if the extrinsics are inverted (sensor from body). RT_sensor_from_body and pos_meter
// decide if present. Otherwise a camera's y axis points down within 60 degrees: extrinsics
// for which only the inverse's does are inverted.
void check_direction(const JsonField& sensor, const Rigid3d& body_from_sensor) {
  const JsonField field = sensor.at("RT_body_from_sensor");
  const Rigid3d inverse = body_from_sensor.inverse();
  bool position_decides = false;
  if (sensor.has("pos_meter")) {
    const std::vector<double> values = sensor.at("pos_meter").numbers(3);
    const Eigen::Vector3d position(values[0], values[1], values[2]);
    const auto agrees = [&](const Rigid3d& pose) {
      return (pose.translation() - position).norm() <= kPositionTolerance_m;
    };
    if (!agrees(body_from_sensor)) {
      const std::string value = "translation " + text(body_from_sensor.translation());
      if (agrees(inverse))
        refuse(
            field, value,
            "inverted: not this, but its inverse places the camera at pos_meter " + text(position));
      refuse(field, value, "disagrees with pos_meter " + text(position) + " by more than 0.01 m");
    }
    position_decides = !agrees(inverse);
  }
  if (sensor.has("RT_sensor_from_body")) {
    const Rigid3d sensor_from_body = rigid_from_json(sensor.at("RT_sensor_from_body"));
    const Rigid3d residual = sensor_from_body * body_from_sensor;
    const double rotation = (residual.linear() - Eigen::Matrix3d::Identity()).norm();
    const double translation_m = residual.translation().norm();
    if (rotation > 2e-3 || translation_m > kPositionTolerance_m) {
      char value[96];
      std::snprintf(value, sizeof value, "off by %.3g in rotation, %.3g m in position", rotation,
                    translation_m);
      refuse(field, value,
             "disagrees with RT_sensor_from_body, which has to be its inverse (is one of them "
             "inverted?)");
    }
  }
  const double y_down = -body_from_sensor.linear()(2, 1),
               y_down_of_inverse = -inverse.linear()(2, 1);
  if (!position_decides && y_down < 0.5 && y_down_of_inverse >= 0.5) {
    refuse(field, "y axis " + text(body_from_sensor.linear().col(1)) + " in body axes",
           "inverted: the y axis of a camera points down (body z = -1), that of the inverse does");
  }
}

CameraCalibration camera_from_json(const JsonField& sensor, const std::string& name) {
  if (!usable_name(name))
    sensor.fail("the name of a camera is made of letters, digits, '_', '-' and '.'");
  CameraCalibration camera;
  camera.name = name;
  camera.model = sensor.at("model").string();
  const CameraModelInfo* model = find_camera_model(camera.model);
  if (!model) sensor.at("model").fail("unknown camera model; known are " + camera_model_names());
  const JsonField resolution = sensor.at("image_resolution_px"),
                  focal = sensor.at("focal_length_px"), center = sensor.at("principal_point_px"),
                  distortion = sensor.at("distortion_coeffs");
  resolution.numbers(2), focal.numbers(2), center.numbers(2);  // shapes, before the elements
  image_size_from_json(resolution.at(std::size_t{0}), resolution.at(std::size_t{1}), &camera);
  camera.parameters = {focal_length_from_json(focal.at(std::size_t{0})),
                       focal_length_from_json(focal.at(std::size_t{1})),
                       principal_point_from_json(center.at(std::size_t{0}), camera.width),
                       principal_point_from_json(center.at(std::size_t{1}), camera.height)};
  distortion.numbers(model->distortion.size());
  for (std::size_t i = 0; i < model->distortion.size(); ++i)
    camera.parameters.push_back(parameter_from_json(distortion.at(i), model->distortion[i]));
  for (const CameraParameter& parameter : model->other)
    camera.parameters.push_back(parameter_from_json(sensor.at(parameter.name), parameter));
  camera.body_from_sensor = extrinsics_from_json(sensor);
  check_direction(sensor, camera.body_from_sensor);
  if (sensor.has("readout_s")) {
    const JsonField readout = sensor.at("readout_s");
    const double readout_s = readout.number();
    if (std::abs(readout_s) > kMaxReadout_s) readout.fail("expected seconds between -0.2 and 0.2");
    camera.readout_ns = std::llround(readout_s * 1e9);
  }
  if (sensor.has(kByColumn)) {
    if (!sensor.at(kByColumn).json().is_boolean())
      sensor.at(kByColumn).fail("true or false was expected");
    camera.readout_by_column = sensor.at(kByColumn).json().get<bool>();
  }
  if (sensor.has("time_offset_s")) {
    const JsonField offset = sensor.at("time_offset_s");
    const double offset_s = offset.number();
    if (std::abs(offset_s) > kMaxTimeOffset_s) offset.fail("expected seconds between -1 and 1");
    camera.time_offset_ns = std::llround(offset_s * 1e9);
  }
  return camera;
}

}  // namespace

std::vector<CameraCalibration> cameras_from_json(const JsonField& sensors, OtherSensors* others) {
  std::vector<CameraCalibration> cameras;
  int lidars = 0;
  for (const std::string& name : sensors.keys()) {
    const JsonField sensor = sensors.at(name);
    if (!sensor.json().is_object()) sensor.fail("expected an object for each sensor");
    if (is_camera(sensor)) {
      cameras.push_back(camera_from_json(sensor, name));
    } else if (others) {
      others->names.push_back(name);
      if (has_type(sensor, "lidar") && sensor.has(kElevation))
        others->lidar_elevation_rad =
            kRadiansPerDegree * number_within(sensor.at(kElevation), -kMaxElevation_deg,
                                              kMaxElevation_deg, "expected degrees, -2 to 2");
      if (has_type(sensor, "lidar") && sensor.has("RT_body_from_sensor")) {
        others->body_from_lidar = extrinsics_from_json(sensor);
        ++lidars;
      }
    }
  }
  if (lidars > 1) others->body_from_lidar.reset();  // revolutions do not name their sensor
  std::sort(cameras.begin(), cameras.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  return cameras;
}

std::vector<CameraCalibration> parse_calibration(std::string_view text,
                                                 const std::filesystem::path& file,
                                                 OtherSensors* others) {
  const nlohmann::json root = parse_json(text, file);
  std::vector<CameraCalibration> cameras = cameras_from_json(JsonField(root, file), others);
  if (cameras.empty()) {
    throw InputError(
        file, "", "",
        "holds no camera: no entry with sensor_type \"camera\", or with model and focal_length_px");
  }
  return cameras;
}

nlohmann::json calibration_to_json(const CameraCalibration& camera) {
  nlohmann::json entry = {{"sensor_type", "camera"},
                          {"model", camera.model},
                          {"image_resolution_px", {camera.width, camera.height}},
                          {"distortion_coeffs", distortion(camera)}};
  for (const auto& [name, value] : other_parameters(camera)) entry[name] = value;
  update_calibration(camera, &entry);
  return entry;
}

void update_calibration(const CameraCalibration& camera, nlohmann::json* entry) {
  nlohmann::json& sensor = *entry;
  const Eigen::Vector3d position = camera.body_from_sensor.translation();
  sensor["RT_body_from_sensor"] = rigid_to_json(camera.body_from_sensor);
  sensor["RT_sensor_from_body"] = rigid_to_json(camera.body_from_sensor.inverse(Eigen::Isometry));
  if (sensor.contains("pos_meter"))
    sensor["pos_meter"] = {position.x(), position.y(), position.z()};
  sensor.erase("yaw_pitch_roll_deg");
  sensor["focal_length_px"] = {camera.fx(), camera.fy()};
  sensor["principal_point_px"] = {camera.cx(), camera.cy()};
  sensor["time_offset_s"] = static_cast<double>(camera.time_offset_ns) * 1e-9;
  if (camera.readout_ns != 0 || sensor.contains("readout_s"))
    sensor["readout_s"] = static_cast<double>(camera.readout_ns) / 1e9;
  if (camera.readout_by_column || sensor.contains(kByColumn))
    sensor[kByColumn] = camera.readout_by_column;
}

void update_lidar(double elevation_rad, nlohmann::json* sensors) {
  auto lidar = std::ranges::find_if(*sensors, [](const nlohmann::json& sensor) {
    return sensor.value("sensor_type", nlohmann::json()) == "lidar";
  });
  if (lidar == sensors->end() && elevation_rad == 0) return;
  nlohmann::json& entry = lidar == sensors->end() ? (*sensors)["lidar"] : *lidar;
  entry["sensor_type"] = "lidar";
  entry.erase(kElevation);
  if (elevation_rad != 0) entry[kElevation] = kDegreesPerRadian * elevation_rad;
}

}  // namespace redrive
