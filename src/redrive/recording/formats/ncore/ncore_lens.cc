// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_lens.h"

#include "redrive/camera/lenses/ftheta_intrinsics.h"
#include "redrive/camera/lenses/opencv_coefficients.h"
#include "redrive/camera/models.h"
#include "redrive/recording/formats/calibration_fields.h"

namespace redrive::ncore {
namespace {

constexpr std::size_t kMostCoefficients = 64;

/// An array of numbers of any length up to 64.
std::vector<double> numbers_of(const JsonField& field) {
  if (!field.json().is_array() || field.size() > kMostCoefficients)
    field.fail("must be an array of at most 64 numbers");
  return field.numbers(field.size());
}

std::vector<double> distortion_of(const JsonField& field, const CameraModelInfo& info,
                                  const std::vector<std::size_t>& order) {
  const std::vector<double> values = field.numbers(order.size());
  for (std::size_t i = 0; i < order.size(); ++i)
    parameter_from_json(field.at(i), info.distortion[order[i]]);
  return values;
}

/// Focal lengths and principal point, which NCore counts from the corner of the first pixel.
void set_pinhole_numbers(const JsonField& p, CameraCalibration* camera) {
  const JsonField focal = p.at("focal_length"), centre = p.at("principal_point");
  const auto at = [](const JsonField& field, std::size_t i) { return field.at(i); };
  camera->parameters = {focal_length_from_json(at(focal, 0)), focal_length_from_json(at(focal, 1)),
                        principal_point_from_json(at(centre, 0), camera->width) - 0.5,
                        principal_point_from_json(at(centre, 1), camera->height) - 0.5};
}

void set_pinhole(const JsonField& p, CameraCalibration* camera) {
  const CameraModelInfo& whole = *find_camera_model("opencv_thin_prism");
  const std::vector<double> k = distortion_of(p.at("radial_coeffs"), whole, {0, 1, 4, 5, 6, 7}),
                            t = distortion_of(p.at("tangential_coeffs"), whole, {2, 3}),
                            s = distortion_of(p.at("thin_prism_coeffs"), whole, {8, 9, 10, 11});
  set_pinhole_numbers(p, camera);
  set_opencv_coefficients({k[0], k[1], t[0], t[1], k[2], k[3], k[4], k[5], s[0], s[1], s[2], s[3]},
                          camera);
}

void set_fisheye(const JsonField& p, CameraCalibration* camera) {
  const CameraModelInfo& fisheye = *find_camera_model("opencv_fisheye");
  const std::vector<double> k = distortion_of(p.at("radial_coeffs"), fisheye, {0, 1, 2, 3});
  set_pinhole_numbers(p, camera);
  camera->model = "opencv_fisheye";
  camera->parameters.insert(camera->parameters.end(), k.begin(), k.end());
}

/// The principal point of this model is counted from the centre of the first pixel.
void set_ftheta_lens(const JsonField& p, CameraCalibration* camera) {
  const JsonField centre = p.at("principal_point"), reference = p.at("reference_poly");
  FThetaIntrinsics lens;
  lens.cx = principal_point_from_json(centre.at(std::size_t{0}), camera->width);
  lens.cy = principal_point_from_json(centre.at(1), camera->height);
  lens.angle_is_reference = reference.string() == "PIXELDIST_TO_ANGLE";
  if (!lens.angle_is_reference && reference.string() != "ANGLE_TO_PIXELDIST")
    reference.fail("must be PIXELDIST_TO_ANGLE or ANGLE_TO_PIXELDIST");
  lens.pixeldist_to_angle = numbers_of(p.at("pixeldist_to_angle_poly"));
  lens.angle_to_pixeldist = numbers_of(p.at("angle_to_pixeldist_poly"));
  lens.max_angle_rad = p.at("max_angle").number();
  if (p.has("linear_cde")) {
    const std::vector<double> cde = p.at("linear_cde").numbers(3);
    lens.c = cde[0], lens.d = cde[1], lens.e = cde[2];
  }
  set_ftheta(lens, p.file().string(), p.field() + ".", camera);
}

WindshieldPolynomials windshield_of(const JsonField& glass) {
  const JsonField reference = glass.at("reference_poly");
  if (reference.string() != "FORWARD" && reference.string() != "BACKWARD")
    reference.fail("must be FORWARD or BACKWARD");
  WindshieldPolynomials out;
  out.horizontal = numbers_of(glass.at("horizontal_poly"));
  out.vertical = numbers_of(glass.at("vertical_poly"));
  out.horizontal_inverse = numbers_of(glass.at("horizontal_poly_inverse"));
  out.vertical_inverse = numbers_of(glass.at("vertical_poly_inverse"));
  return out;
}

JsonField parameters_of(const JsonField& intrinsics) {
  return intrinsics.at("camera_model_parameters");
}

}  // namespace

int parse_shutter(const JsonField& intrinsics, CameraCalibration* camera) {
  const JsonField field = parameters_of(intrinsics).at("shutter_type");
  const std::string type = field.string();
  camera->readout_by_column = type == "ROLLING_LEFT_TO_RIGHT" || type == "ROLLING_RIGHT_TO_LEFT";
  if (type == "GLOBAL") return 0;
  if (type == "ROLLING_TOP_TO_BOTTOM" || type == "ROLLING_LEFT_TO_RIGHT") return 1;
  if (type == "ROLLING_BOTTOM_TO_TOP" || type == "ROLLING_RIGHT_TO_LEFT") return -1;
  field.fail("must be GLOBAL or a ROLLING_..._TO_...");
}

void parse_lens(const JsonField& intrinsics, CameraCalibration* camera,
                std::vector<Finding>* findings) {
  const JsonField type = intrinsics.at("camera_model_type"), p = parameters_of(intrinsics),
                  size = p.at("resolution");
  image_size_from_json(size.at(std::size_t{0}), size.at(1), camera);
  if (type.string() == "opencv-pinhole")
    set_pinhole(p, camera);
  else if (type.string() == "opencv-fisheye")
    set_fisheye(p, camera);
  else if (type.string() == "ftheta")
    set_ftheta_lens(p, camera);
  else
    type.fail("must be ftheta, opencv-pinhole or opencv-fisheye");
  if (p.has("external_distortion_parameters") &&
      !p.at("external_distortion_parameters").json().is_null()) {
    const JsonField glass = p.at("external_distortion_parameters");
    const WindshieldPolynomials polynomials = windshield_of(glass);
    const bool higher = polynomials.horizontal.size() > kWindshieldTermsH ||
                        polynomials.vertical.size() > kWindshieldTermsV;
    if (type.string() == "ftheta" && !higher)
      set_windshield(polynomials, glass.file().string(), glass.field() + ".", camera);
    else
      findings->push_back(
          {camera->name,
           std::string("looks through a windshield that is not modelled: its ") +
               (higher ? "polynomials are of a higher order than 2 and 4" : "lens is no ftheta") +
               "; its distortion is not used"});
  }
}

}  // namespace redrive::ncore
