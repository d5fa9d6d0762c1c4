// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/ncore/ncore_terms.h"

#include <algorithm>
#include <cctype>
#include <optional>
#include <string_view>
#include <variant>
#include <vector>

#include "redrive/camera/lenses/ftheta_intrinsics.h"
#include "redrive/camera/lenses/opencv_coefficients.h"
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
  return opencv_coefficients(camera) || camera.model == "opencv_fisheye" ||
         ftheta_intrinsics(camera);
}

Json camera_model(const CameraCalibration& camera, const Camera& lens) {
  const std::vector<double>& p = camera.parameters;
  Json parameters = {{"resolution", {camera.width, camera.height}},
                     {"shutter_type", shutter_name(camera)},
                     {"external_distortion_parameters", nullptr},
                     {"principal_point", {camera.cx() + 0.5, camera.cy() + 0.5}},
                     {"focal_length", {camera.fx(), camera.fy()}}};
  std::string type = camera.model;
  if (const std::optional<OpenCvCoefficients> all = opencv_coefficients(camera)) {
    const auto& [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = *all;
    type = "opencv-pinhole";
    parameters["radial_coeffs"] = {k1, k2, k3, k4, k5, k6};
    parameters["tangential_coeffs"] = {p1, p2};
    parameters["thin_prism_coeffs"] = {s1, s2, s3, s4};
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
