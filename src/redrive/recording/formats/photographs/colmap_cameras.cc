// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/colmap_cameras.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/camera/models.h"
#include "redrive/recording/formats/calibration_fields.h"

namespace redrive::colmap {
namespace {

/// Index of a parameter in CameraCalibration::parameters.
std::size_t index_of(const CameraModelInfo& model, std::string_view name) {
  constexpr std::string_view kPinhole[] = {"fx", "fy", "cx", "cy"};
  if (const auto* at = std::ranges::find(kPinhole, name); at != std::end(kPinhole))
    return static_cast<std::size_t>(at - kPinhole);
  std::size_t index = 4;
  for (const auto& parameters : {model.distortion, model.other})
    for (const CameraParameter& parameter : parameters) {
      if (parameter.name == name) return index;
      ++index;
    }
  REDRIVE_CHECK(!"a parameter of the table is unknown");
}

std::string shown(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

/// Throws unless least <= value <= most.
void check_range(double value, double least, double most, const std::string& field,
                 const std::filesystem::path& file) {
  if (value >= least && value <= most) return;
  char rule[80];
  std::snprintf(rule, sizeof rule, "must be between %g and %g", least, most);
  throw InputError(file, field, shown(value), rule);
}

}  // namespace

const std::vector<CameraModel>& camera_models() {
  static const std::vector<CameraModel> models = {
      {0, "SIMPLE_PINHOLE", "opencv_pinhole", {"f", "cx", "cy"}},
      {1, "PINHOLE", "opencv_pinhole", {"fx", "fy", "cx", "cy"}},
      {2, "SIMPLE_RADIAL", "opencv_pinhole", {"f", "cx", "cy", "k1"}},
      {8, "SIMPLE_RADIAL_FISHEYE", "opencv_fisheye", {"f", "cx", "cy", "k1"}},
      {3, "RADIAL", "opencv_pinhole", {"f", "cx", "cy", "k1", "k2"}},
      {9, "RADIAL_FISHEYE", "opencv_fisheye", {"f", "cx", "cy", "k1", "k2"}},
      {7, "FOV", "fov", {"fx", "fy", "cx", "cy", "omega"}},
      {4, "OPENCV", "opencv_pinhole", {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}},
      {5, "OPENCV_FISHEYE", "opencv_fisheye", {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"}},
      {6,
       "FULL_OPENCV",
       "opencv_rational",
       {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}},
      {10,
       "THIN_PRISM_FISHEYE",
       "thin_prism_fisheye",
       {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"}},
  };
  return models;
}

const CameraModel* find_camera_model(std::string_view name) {
  const auto found = std::ranges::find(camera_models(), name, &CameraModel::name);
  return found == camera_models().end() ? nullptr : &*found;
}

const CameraModel* find_camera_model(int id) {
  const auto found = std::ranges::find(camera_models(), id, &CameraModel::id);
  return found == camera_models().end() ? nullptr : &*found;
}

std::string camera_model_names() {
  std::string names;
  for (const CameraModel& model : camera_models())
    names += (names.empty() ? "" : ", ") + std::string(model.name);
  return names;
}

CameraCalibration to_calibration(const CameraRecord& record, const std::filesystem::path& file) {
  const CameraModel& model = *find_camera_model(record.model_id);
  const CameraModelInfo& info = *redrive::find_camera_model(model.redrive);
  REDRIVE_CHECK_OP(record.params.size(), ==, model.parameters.size());
  const std::string camera = "camera " + std::to_string(record.id) + " ";
  CameraCalibration out;
  out.model = model.redrive;
  check_range(static_cast<double>(record.width), 1, kMaxImageSize_px, camera + "width", file);
  check_range(static_cast<double>(record.height), 1,
              std::min(kMaxImageSize_px, double(kMaxPixels / record.width)), camera + "height",
              file);
  out.width = static_cast<int>(record.width);
  out.height = static_cast<int>(record.height);
  out.parameters.assign(4 + info.distortion.size() + info.other.size(), 0);
  for (std::size_t i = 0; i < model.parameters.size(); ++i) {
    const std::string_view name = model.parameters[i];
    const double value = record.params[i];
    const std::string field = camera + std::string(name);
    if (name[0] == 'f') {
      check_range(value, 1e-6, kMaxFocalLength_px, field, file);
      if (name != "fy") out.parameters[0] = value;
      if (name != "fx") out.parameters[1] = value;
    } else if (name[0] == 'c') {
      const int size = name == "cx" ? out.width : out.height;
      check_range(value, -size, 2.0 * size, field, file);
      out.parameters[index_of(info, name)] = value - 0.5;
    } else {
      const std::size_t index = index_of(info, name);
      const CameraParameter& parameter = index - 4 < info.distortion.size()
                                             ? info.distortion[index - 4]
                                             : info.other[index - 4 - info.distortion.size()];
      check_range(value, parameter.min, parameter.max, field, file);
      out.parameters[index] = value;
    }
  }
  return out;
}

std::optional<CameraRecord> to_record(const CameraCalibration& calibration) {
  // Five coefficients are eight, of which three are 0.
  CameraCalibration camera = calibration;
  if (camera.model == "opencv_pinhole" && camera.parameters[8] != 0) {
    camera.model = "opencv_rational";
    camera.parameters.resize(12, 0);
  }
  for (const CameraModel& model : camera_models()) {
    if (model.redrive != camera.model) continue;
    const CameraModelInfo& info = *redrive::find_camera_model(model.redrive);
    CameraRecord record{0, model.id, camera.width, camera.height, {}};
    std::vector<double> left_out = camera.parameters;
    for (const std::string_view name : model.parameters) {
      const std::size_t index = name == "f" ? 0 : index_of(info, name);
      record.params.push_back(camera.parameters[index] + (name[0] == 'c' ? 0.5 : 0));
      left_out[index] = 0;
      if (name == "f") left_out[1] -= camera.parameters[0];
    }
    if (std::ranges::all_of(left_out, [](double value) { return value == 0; })) return record;
  }
  return std::nullopt;
}

}  // namespace redrive::colmap
