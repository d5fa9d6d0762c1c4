// SPDX-License-Identifier: Apache-2.0
// The parser of transforms.json; transforms.cc finds the files.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <set>
#include <span>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/math/angles.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/formats/photographs/transforms.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::transforms {
namespace {

constexpr double kMaxScale = 1e6;

/// Fields of a frame, which take precedence over the file's.
struct Intrinsics {
  JsonField frame, all;

  std::optional<JsonField> find(std::string_view key) const {
    if (frame.has(key)) return frame.at(key);
    if (all.has(key)) return all.at(key);
    return std::nullopt;
  }
};

std::string path_from_json(const JsonField& field) {
  std::string path = field.string();
  std::replace(path.begin(), path.end(), '\\', '/');
  if (path.empty() || path.find('\0') != std::string::npos)
    field.fail("expected the name of a file");
  return std::filesystem::path(path).lexically_normal().string();
}

/// InputError for fields that change geometry or colours of the images and are not supported.
void refuse_unsupported(const JsonField& object) {
  for (const char* key :
       {"rolling_shutter", "ftheta_p0", "latlong", "equirectangular", "fisheye_crop_radius",
        "white_transparent", "black_transparent", "transform_matrix_start", "normal_mts_args"}) {
    if (!object.has(key)) continue;
    const auto is_empty = [](const nlohmann::json& value) {
      return value.is_null() || value == false || value == 0;
    };
    const nlohmann::json& value = object.at(key).json();
    const bool empty =
        value.is_array() ? std::all_of(value.begin(), value.end(), is_empty) : is_empty(value);
    if (!empty) object.at(key).fail("is not supported");
  }
}

/// Returns the model of "camera_model", else OPENCV_FISHEYE by "is_fisheye", else OPENCV.
const CameraModelInfo& camera_model_of(const Intrinsics& intrinsics) {
  std::string name = "OPENCV";
  if (const auto flag = intrinsics.find("is_fisheye")) {
    if (!flag->json().is_boolean()) flag->fail("true or false was expected");
    if (flag->json().get<bool>()) name = "OPENCV_FISHEYE";
  }
  const auto field = intrinsics.find("camera_model");
  if (field) name = field->string();
  std::string known;
  for (const CameraModelInfo& model : camera_models())
    for (const std::string_view known_name : model.transforms_names) {
      if (known_name == name) return model;
      known += (known.empty() ? "" : ", ") + std::string(known_name);
    }
  field->fail("unknown camera model; known are " + known);
}

/// Returns the coefficient, or 0 if the field is missing.
double coefficient(const Intrinsics& intrinsics, const CameraParameter& parameter) {
  const auto field = intrinsics.find(parameter.name);
  return field ? parameter_from_json(*field, parameter) : 0;
}

void read_distortion(const Intrinsics& intrinsics, const CameraModelInfo& model,
                     CameraCalibration* camera) {
  camera->model = model.name;
  for (const CameraParameter& parameter : model.distortion)
    camera->parameters.push_back(coefficient(intrinsics, parameter));
  for (const CameraParameter& parameter : model.other) {
    const auto field = intrinsics.find(parameter.name);
    if (!field) intrinsics.frame.at(parameter.name);  // throws: missing
    camera->parameters.push_back(parameter_from_json(*field, parameter));
  }
  // Programs disagree about the meaning of a pinhole's k4.
  for (const char* key : {"k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"})
    if (std::ranges::find(model.distortion, key, &CameraParameter::name) ==
            model.distortion.end() &&
        coefficient(intrinsics, {key}) != 0)
      intrinsics.find(key)->fail("must be 0, the model " + camera->model +
                                 " has no such coefficient");
}

/// Returns the focal length along `axis` ("x" or "y"), or nothing if `object` has none.
std::optional<double> focal_length(const JsonField& object, const std::string& axis, int size) {
  if (object.has("fl_" + axis)) return focal_length_from_json(object.at("fl_" + axis));
  const bool degrees = object.has(axis + "_fov");
  if (!degrees && !object.has("camera_angle_" + axis)) return std::nullopt;
  const JsonField field = object.at(degrees ? axis + "_fov" : "camera_angle_" + axis);
  const double angle_rad = field.number() * (degrees ? kRadiansPerDegree : 1);
  if (!(angle_rad > 1e-3 && angle_rad < std::numbers::pi - 1e-3))
    field.fail(degrees ? "expected degrees between 0.06 and 179.94"
                       : "expected radians between 0.001 and 3.14");
  return 0.5 * size / std::tan(0.5 * angle_rad);
}

CameraCalibration camera_from_json(const Intrinsics& intrinsics, const ImageSize& size) {
  CameraCalibration camera;
  camera.width = size.width;
  camera.height = size.height;
  double fx = 0, fy = 0;
  for (const JsonField& object : {intrinsics.frame, intrinsics.all}) {
    const auto x = focal_length(object, "x", size.width),
               y = focal_length(object, "y", size.height);
    if (!x && !y) continue;
    fx = x ? *x : *y;
    fy = y ? *y : *x;
    break;
  }
  if (fx == 0)
    intrinsics.frame.fail(
        "no focal length: neither fl_x nor camera_angle_x, here or for all frames");
  const CameraModelInfo& model = camera_model_of(intrinsics);
  const auto cx = intrinsics.find("cx"), cy = intrinsics.find("cy");
  camera.parameters = {
      fx, fy, (cx ? principal_point_from_json(*cx, size.width) : 0.5 * size.width) - 0.5,
      (cy ? principal_point_from_json(*cy, size.height) : 0.5 * size.height) - 0.5};
  read_distortion(intrinsics, model, &camera);
  if (!model.perspective && !intrinsics.find("fl_x"))
    intrinsics.frame.fail("a fisheye needs fl_x: programs disagree about its angle of view");
  camera.body_from_sensor = photographs::body_from_camera();
  return camera;
}

Rigid3d global_from_body_from_matrix(const JsonField& field) {
  Rigid3d global_from_body = rigid_from_json(field);
  if (global_from_body.translation().norm() > photographs::kMaxDistance)
    field.fail("expected a position within 1e7 of the origin");
  // Columns: the body's x (forward), y (left) and z (up) in OpenGL's camera axes x right, y up, z
  // backward.
  Eigen::Matrix3d opengl_from_body;
  opengl_from_body << 0, -1, 0, 0, 0, 1, -1, 0, 0;
  global_from_body.linear() = global_from_body.linear() * opengl_from_body;
  return global_from_body;
}

std::optional<BoundingCube> bounds_from_json(const JsonField& root) {
  if (!root.has("aabb_scale") && !root.has("aabb")) return std::nullopt;
  const auto positive = [](const JsonField& field) {
    const double value = field.number();
    if (!(value > 1 / kMaxScale && value <= kMaxScale))
      field.fail("expected a number above 1e-6, at most 1e6");
    return value;
  };
  const double aabb_scale = root.has("aabb_scale") ? positive(root.at("aabb_scale")) : 1;
  if (root.has("aabb")) {
    const JsonField aabb = root.at("aabb");
    const std::vector<double> low = aabb.at(std::size_t{0}).numbers(3),
                              high = aabb.at(std::size_t{1}).numbers(3);
    const Eigen::Vector3d a(low[0], low[1], low[2]), b(high[0], high[1], high[2]);
    const double side = (b - a).cwiseAbs().maxCoeff();
    if (!(side > 1 / kMaxScale && a.norm() <= photographs::kMaxDistance &&
          b.norm() <= photographs::kMaxDistance))
      aabb.fail("expected two corners of a box, within 1e7 of the origin");
    return BoundingCube{0.5 * (a + b), 0.5 * aabb_scale * side};
  }
  const double scale = root.has("scale") ? positive(root.at("scale")) : 0.33;
  Eigen::Vector3d offset = Eigen::Vector3d::Constant(0.5);
  if (root.has("offset")) {
    const JsonField field = root.at("offset");
    if (field.json().is_array()) {
      const std::vector<double> values = field.numbers(3);
      offset = Eigen::Vector3d(values[0], values[1], values[2]);
    } else {
      offset.setConstant(field.number());
    }
    if (!(offset.norm() <= photographs::kMaxDistance)) field.fail("expected at most 1e7");
  }
  return instant_ngp_cube(aabb_scale, scale, offset);
}

std::optional<std::vector<std::string>> names_from_json(const JsonField& root, const char* key,
                                                        const std::set<std::string>& known) {
  if (!root.has(key)) return std::nullopt;
  const JsonField list = root.at(key);
  if (!list.json().is_array()) list.fail("a list of file names was expected");
  std::vector<std::string> names;
  for (std::size_t i = 0; i < list.size(); ++i) {
    names.push_back(path_from_json(list.at(i)));
    if (!known.contains(names.back())) list.at(i).fail("is the file_path of no frame");
  }
  return names;
}

}  // namespace

BoundingCube instant_ngp_cube(double aabb_scale, double scale, const Eigen::Vector3d& offset) {
  return {(Eigen::Vector3d::Constant(0.5) - offset) / scale, 0.5 * aabb_scale / scale};
}

TransformsFile parse(std::string_view text, const std::filesystem::path& file,
                     const std::function<std::optional<ImageSize>(const std::string&)>& size_of,
                     const DamagedList* damaged) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file), frames = root.at("frames");
  if (!frames.json().is_array() || frames.size() == 0)
    frames.fail("expected a list of at least one frame");
  refuse_unsupported(root);
  TransformsFile result;
  std::set<std::string> names;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const JsonField frame = frames.at(i);
    refuse_unsupported(frame);
    const Intrinsics intrinsics{frame, root};
    FrameEntry entry;
    entry.file = path_from_json(frame.at("file_path"));
    if (!names.insert(entry.file).second) frame.at("file_path").fail("is listed twice");
    if (frame.has("mask_path")) entry.mask = path_from_json(frame.at("mask_path"));
    if (!parse_record(damaged, -1, [&] {
          entry.global_from_body = global_from_body_from_matrix(frame.at("transform_matrix"));
        }))
      continue;
    const auto width = intrinsics.find("w"), height = intrinsics.find("h");
    if (width.has_value() != height.has_value())
      (width ? *width : *height).fail("w and h must both be present or both be absent");
    CameraCalibration size;
    if (width) image_size_from_json(*width, *height, &size);
    const std::optional<ImageSize> known =
        width ? ImageSize{size.width, size.height} : size_of(entry.file);
    if (known) entry.camera = camera_from_json(intrinsics, *known);
    result.entries.push_back(std::move(entry));
  }
  if (root.has("ply_file_path")) result.points = path_from_json(root.at("ply_file_path"));
  result.bounds = bounds_from_json(root);
  result.train = names_from_json(root, "train_filenames", names);
  result.val = names_from_json(root, "val_filenames", names);
  result.test = names_from_json(root, "test_filenames", names);
  return result;
}

}  // namespace redrive::transforms
