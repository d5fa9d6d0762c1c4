// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti360/kitti360_calibration.h"

#include "redrive/base/error.h"
#include "redrive/camera/models.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive::kitti360 {
namespace {

constexpr double kAnyEntry = 1e6;

Rigid3d rigid_from_rows(const std::vector<double>& m, const std::string& name,
                        const std::filesystem::path& file) {
  return kitti::rigid_from_numbers({m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]},
                                   {m[3], m[7], m[11]}, name, file);
}

/// Returns {"key": value, "section": {"key": value}} of numbers, or of texts where they are none.
nlohmann::json sections_of_yaml(std::string_view text, const std::filesystem::path& file) {
  nlohmann::json document = nlohmann::json::object();
  std::string section;
  std::size_t number = 0;
  for (std::size_t begin = 0; begin < text.size(); ++number) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view row = text.substr(begin, end - begin);
    begin = end + 1;
    const TextLine words(row, file, number + 1);
    if (words.size() == 0 || row[0] == '%' || row[0] == '#' || row.starts_with("---")) continue;
    const std::size_t colon = row.find(':');
    const std::size_t first = row.find_first_not_of(" \t");
    if (colon == row.npos || words.word(0).starts_with(':'))
      words.fail(0, "key", "expected \"key: value\" in each line");
    const std::string key(row.substr(first, colon - first));
    const std::string_view behind = row.substr(colon + 1);
    const TextLine value(behind, file, number + 1);
    if (first == 0) section.clear();
    nlohmann::json& object = section.empty() ? document : document[section];
    if (object.contains(key)) words.fail(0, "key", "stands in an earlier line, too");
    if (value.size() == 0) {
      object[key] = nlohmann::json::object();
      if (first == 0) section = key;
    } else {
      object[key] = kitti::value_of(value.word(0));
    }
  }
  return document;
}

}  // namespace

std::map<int, PerspectiveCamera> parse_perspective(std::string_view text,
                                                   const std::filesystem::path& file) {
  const nlohmann::json document = kitti::key_values(text, file);
  const JsonField root(document, file);
  std::map<int, PerspectiveCamera> cameras;
  for (const int c : {0, 1}) {
    const std::string number = "0" + std::to_string(c);
    if (!root.has("P_rect_" + number)) continue;
    const std::string rotation = "R_rect_" + number;
    cameras[c] = {
        kitti::camera_from_projection(root.at("P_rect_" + number),
                                      kitti::size_from_json(root.at("S_rect_" + number))),
        kitti::rigid_from_numbers(root.at(rotation).numbers(9), {0, 0, 0}, rotation, file)};
  }
  return cameras;
}

CameraCalibration parse_fisheye(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = sections_of_yaml(text, file);
  const JsonField root(document, file);
  if (root.at("model_type").string() != "MEI")
    root.at("model_type").fail("expected MEI, the model of KITTI-360's fisheyes");
  const CameraModelInfo& model = *find_camera_model("mei");
  CameraCalibration camera;
  camera.model = "mei";
  image_size_from_json(root.at("image_width"), root.at("image_height"), &camera);
  const JsonField projection = root.at("projection_parameters"),
                  distortion = root.at("distortion_parameters");
  camera.parameters = {focal_length_from_json(projection.at("gamma1")),
                       focal_length_from_json(projection.at("gamma2")),
                       principal_point_from_json(projection.at("u0"), camera.width),
                       principal_point_from_json(projection.at("v0"), camera.height)};
  for (const CameraParameter& parameter : model.distortion)
    camera.parameters.push_back(
        parameter.name == "k3" ? 0 : parameter_from_json(distortion.at(parameter.name), parameter));
  camera.parameters.push_back(
      parameter_from_json(root.at("mirror_parameters").at("xi"), model.other[0]));
  return camera;
}

std::map<std::string, Rigid3d> parse_cam_to_pose(std::string_view text,
                                                 const std::filesystem::path& file) {
  const nlohmann::json document = kitti::key_values(text, file);
  const JsonField root(document, file);
  std::map<std::string, Rigid3d> imu_from_camera;
  for (const std::string& name : root.keys())
    imu_from_camera[name] = rigid_from_rows(root.at(name).numbers(12), name, file);
  return imu_from_camera;
}

Rigid3d parse_cam_to_velo(std::string_view text, const std::filesystem::path& file) {
  const std::vector<TextLine> lines = text_lines(text, file);
  if (lines.size() != 1)
    throw InputError(file, "number of lines", std::to_string(lines.size()),
                     "expected one, with the 12 numbers of a 3 x 4 matrix");
  lines[0].expect_size(12, "the rows of a 3 x 4 matrix");
  std::vector<double> numbers;
  for (std::size_t i = 0; i < 12; ++i)
    numbers.push_back(lines[0].number(i, "value " + std::to_string(i + 1), -kAnyEntry, kAnyEntry));
  return rigid_from_rows(numbers, "velodyne_from_camera", file);
}

}  // namespace redrive::kitti360
