// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/ncore/ncore_terms.h"

#include <algorithm>
#include <cctype>
#include <optional>
#include <string_view>
#include <variant>
#include <vector>

#include "redrive/camera/lenses/ftheta_intrinsics.h"
#include "redrive/recording/core/actor_kind.h"

namespace redrive::ncore {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char *kDistortionType = "external_distortion_type",
                     *kWindshieldType = "bivariate-windshield";

const char* shutter_name(const CameraCalibration& camera) {
  if (camera.readout_ns == 0) return "GLOBAL";
  const bool ahead = camera.readout_ns > 0;
  if (camera.readout_by_column) return ahead ? "ROLLING_LEFT_TO_RIGHT" : "ROLLING_RIGHT_TO_LEFT";
  return ahead ? "ROLLING_TOP_TO_BOTTOM" : "ROLLING_BOTTOM_TO_TOP";
}

std::string in_lower_case(const std::string& type) {
  std::string word;
  for (const unsigned char c : type) word += static_cast<char>(std::tolower(c));
  return word;
}

}  // namespace

bool has_model(const CameraCalibration& camera) {
  return camera.model == "opencv_pinhole" || camera.model == "opencv_rational" ||
         camera.model == "opencv_fisheye" || ftheta_intrinsics(camera);
}

Json camera_model(const CameraCalibration& camera, const Camera& lens) {
  const std::vector<double>& p = camera.parameters;
  Json parameters = {{"resolution", {camera.width, camera.height}},
                     {"shutter_type", shutter_name(camera)},
                     {"external_distortion_parameters", nullptr},
                     {"principal_point", {camera.cx() + 0.5, camera.cy() + 0.5}},
                     {"focal_length", {camera.fx(), camera.fy()}}};
  std::string type = camera.model;
  if (type == "opencv_pinhole" || type == "opencv_rational") {
    type = "opencv-pinhole";
    Json radial = Json::array();
    for (const std::size_t k : {4, 5, 8, 9, 10, 11}) radial.push_back(k < p.size() ? p[k] : 0.0);
    parameters["radial_coeffs"] = radial;
    parameters["tangential_coeffs"] = {p.at(6), p.at(7)};
    parameters["thin_prism_coeffs"] = {0.0, 0.0, 0.0, 0.0};
  } else if (const auto* fisheye = std::get_if<OpenCvFisheye>(&lens.model)) {
    type = "opencv-fisheye";
    parameters["radial_coeffs"] = std::vector<double>(p.begin() + 4, p.begin() + 8);
    parameters["max_angle"] = fisheye->max_angle_rad;
  } else if (const std::optional<FThetaIntrinsics> ftheta = ftheta_intrinsics(camera)) {
    type = "ftheta";
    parameters["principal_point"] = {camera.cx(), camera.cy()};
    parameters.erase("focal_length");
    parameters["reference_poly"] =
        ftheta->angle_is_reference ? "PIXELDIST_TO_ANGLE" : "ANGLE_TO_PIXELDIST";
    parameters["pixeldist_to_angle_poly"] = ftheta->pixeldist_to_angle;
    parameters["angle_to_pixeldist_poly"] = ftheta->angle_to_pixeldist;
    parameters["max_angle"] = ftheta->max_angle_rad;
    parameters["linear_cde"] = {ftheta->c, ftheta->d, ftheta->e};
    if (const std::optional<WindshieldPolynomials> glass = windshield_polynomials(camera))
      parameters["external_distortion_parameters"] = {
          {kDistortionType, kWindshieldType},
          {"reference_poly", "FORWARD"},
          {"horizontal_poly", glass->horizontal},
          {"vertical_poly", glass->vertical},
          {"horizontal_poly_inverse", glass->horizontal_inverse},
          {"vertical_poly_inverse", glass->vertical_inverse}};
  } else {
    parameters["parameters"] = std::vector<double>(p.begin() + 4, p.end());
  }
  Json model = {{"type", type}, {"parameters", parameters}};
  // Older loaders look for the glass's type here, newer ones beside its numbers.
  if (!parameters["external_distortion_parameters"].is_null())
    model[kDistortionType] = kWindshieldType;
  return model;
}

std::string class_of(const std::string& type) {
  const std::string word = in_lower_case(type);
  const auto has = [&](const char* part) { return word.find(part) != word.npos; };
  if (std::string_view(kind_of(type).name) == "person")
    return has("cycl") || has("rider")   ? "rider"
           : has("animal") || has("dog") ? "animal"
                                         : "person";
  return has("bus")       ? "bus"
         : has("trailer") ? "trailer"
         : has("truck")   ? "heavy_truck"
                          : "automobile";
}

std::string class_of_box(const std::string& type) {
  if (std::string_view(kind_of(type).name) == "person") return class_of(type);
  const std::string text = in_lower_case(type);
  if (text.find("cycle") != text.npos) return type;
  constexpr const char* kLetters = "abcdefghijklmnopqrstuvwxyz";
  for (std::size_t begin = text.find_first_of(kLetters); begin != text.npos;) {
    const std::size_t end = std::min(text.find_first_not_of(kLetters, begin), text.size());
    const std::string word = text.substr(begin, end - begin);
    for (const char* const vehicle : {"automobile", "bus", "car", "pickup", "suv", "taxi",
                                      "trailer", "truck", "van", "vehicle"})
      if (word == vehicle) return class_of(type);
    begin = text.find_first_of(kLetters, end);
  }
  return type;
}

}  // namespace redrive::ncore
