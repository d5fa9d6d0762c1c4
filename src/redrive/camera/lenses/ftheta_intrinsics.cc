// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/ftheta_intrinsics.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <utility>

#include <Eigen/QR>

#include "redrive/base/error.h"
#include "redrive/camera/lenses/roots.h"
#include "redrive/camera/models.h"

namespace redrive {
namespace {

constexpr std::size_t kCoefficients = 6;

/// Returns the coefficients k of y = k[1] x + ... + k[5] x^5 that fit pairs (x, y) best.
std::vector<double> fit_polynomial(const Eigen::VectorXd& x, const Eigen::VectorXd& y) {
  const double scale = x.maxCoeff();
  Eigen::MatrixXd powers(x.size(), kCoefficients - 1);
  powers.col(0) = x / scale;
  for (int k = 1; k < powers.cols(); ++k) powers.col(k) = powers.col(k - 1).cwiseProduct(x) / scale;
  const Eigen::VectorXd solution = powers.colPivHouseholderQr().solve(y);
  std::vector<double> k{0};
  for (int i = 0; i < solution.size(); ++i) k.push_back(solution[i] / std::pow(scale, i + 1));
  return k;
}

/// Index and number of the windshield's coefficients among a camera's parameters.
constexpr std::ptrdiff_t kFirstGlass = 8, kGlass = kWindshieldTermsH + kWindshieldTermsV;

bool has_windshield(const CameraCalibration& camera) {
  return camera.model == Windshield<FTheta>::kName ||
         camera.model == Windshield<FThetaInverse>::kName;
}

void check_ranges(const CameraCalibration& camera, const std::string& file,
                  const std::string& field) {
  const CameraModelInfo& info = *find_camera_model(camera.model);
  for (std::size_t i = 4; i < camera.parameters.size(); ++i) {
    const std::size_t n = info.distortion.size();
    const CameraParameter& p = i - 4 < n ? info.distortion[i - 4] : info.other[i - 4 - n];
    if (!(camera.parameters[i] >= p.min && camera.parameters[i] <= p.max))
      throw InputError(file, field + std::string(p.name), std::to_string(camera.parameters[i]),
                       "is out of range");
  }
}

/// Fills the terms of a polynomial of a lower order up with zeros to `order`. Returns nothing if
/// their number fits no order.
std::vector<double> with_order(const std::vector<double>& terms, int order) {
  for (int of = 0; of <= order; ++of) {
    if (terms.size() != static_cast<std::size_t>(windshield_terms(of))) continue;
    std::vector<double> all;
    auto next = terms.begin();
    for (int j = 0; j <= order; ++j)
      for (int i = 0; i + j <= order; ++i) all.push_back(i + j <= of ? *next++ : 0);
    return all;
  }
  return {};
}

/// Returns the terms of the polynomial of that order that fits `to` at `from` best.
std::vector<double> fit_bivariate(const std::vector<Eigen::Vector2d>& from,
                                  const Eigen::VectorXd& to, int order) {
  Eigen::MatrixXd powers(from.size(), windshield_terms(order));
  for (Eigen::Index row = 0; row < powers.rows(); ++row) {
    int column = 0;
    double theta = 1;
    for (int j = 0; j <= order; ++j, theta *= from[row].y()) {
      double term = theta;
      for (int i = 0; i + j <= order; ++i, term *= from[row].x()) powers(row, column++) = term;
    }
  }
  const Eigen::VectorXd terms = powers.colPivHouseholderQr().solve(to);
  return {terms.begin(), terms.end()};
}

}  // namespace

void set_ftheta(const FThetaIntrinsics& lens, const std::string& file, const std::string& field,
                CameraCalibration* camera) {
  const auto refuse = [&](const std::string& part, const std::string& value, const char* rule) {
    throw InputError(file, field + part, value, rule);
  };
  const char* const name =
      lens.angle_is_reference ? "pixeldist_to_angle_poly" : "angle_to_pixeldist_poly";
  std::vector<double> k =
      lens.angle_is_reference ? lens.pixeldist_to_angle : lens.angle_to_pixeldist;
  if (k.size() < 2 || k.size() > kCoefficients)
    refuse(name, std::to_string(k.size()) + " numbers", "must have 2 to 6 coefficients");
  k.resize(kCoefficients);
  if (!std::ranges::all_of(k, [](double x) { return std::isfinite(x); }))
    refuse(name, "NaN or infinity", "must have finite coefficients");
  // Pixels per radian on the axis.
  const double focal_px = lens.angle_is_reference ? 1 / k[1] : k[1];
  if (k[0] != 0) refuse(std::string(name) + "[0]", std::to_string(k[0]), "must be 0");
  if (!(focal_px >= 1 && focal_px <= 1e6))
    refuse(std::string(name) + "[1]", std::to_string(k[1]), "must be 1 to 1e6 pixels per radian");
  if (!(lens.c > 0.1 && lens.c < 10))
    refuse("linear_cde.c", std::to_string(lens.c), "must be 0.1 to 10");
  camera->model = lens.angle_is_reference ? FThetaInverse::kName : FTheta::kName;
  camera->parameters = {lens.c * focal_px, focal_px, lens.cx, lens.cy};
  const double unit = lens.angle_is_reference ? focal_px : 1;
  for (int i = 2; i < static_cast<int>(kCoefficients); ++i)
    camera->parameters.push_back(k[i] / k[1] * std::pow(unit, i - 1));
  camera->parameters.insert(
      camera->parameters.end(),
      {lens.d / lens.c, lens.e, lens.max_angle_rad > 0 ? lens.max_angle_rad : std::numbers::pi});
  check_ranges(*camera, file, field);
}

void set_windshield(const WindshieldPolynomials& glass, const std::string& file,
                    const std::string& field, CameraCalibration* camera) {
  const bool inverse = camera->model == FThetaInverse::kName;
  REDRIVE_CHECK(inverse || camera->model == FTheta::kName);
  std::vector<double> all;
  const auto add = [&](const char* name, const std::vector<double>& given, int order,
                       const char* rule) {
    const std::vector<double> terms = with_order(given, order);
    if (terms.empty())
      throw InputError(file, field + name, std::to_string(given.size()) + " numbers", rule);
    if (!std::ranges::all_of(terms, [](double x) { return std::isfinite(x); }))
      throw InputError(file, field + name, "NaN or infinity", "must have finite coefficients");
    all.insert(all.end(), terms.begin(), terms.end());
  };
  add("horizontal_poly", glass.horizontal, kWindshieldOrderH, "must have 1, 3 or 6 coefficients");
  add("vertical_poly", glass.vertical, kWindshieldOrderV,
      "must have 1, 3, 6, 10 or 15 coefficients");
  constexpr double kLeastCovered_rad = 0.1;
  if (!(WindshieldGlass(all).covered_rad > kLeastCovered_rad))
    throw InputError(file, field + "horizontal_poly", "a windshield",
                     "must be one-to-one about the axis");
  camera->parameters.insert(camera->parameters.begin() + kFirstGlass, all.begin(), all.end());
  camera->model = inverse ? Windshield<FThetaInverse>::kName : Windshield<FTheta>::kName;
  check_ranges(*camera, file, field);
}

std::optional<FThetaIntrinsics> ftheta_intrinsics(const CameraCalibration& camera) {
  const bool behind_glass = has_windshield(camera),
             inverse = camera.model == FThetaInverse::kName ||
                       camera.model == Windshield<FThetaInverse>::kName;
  if (!inverse && !behind_glass && camera.model != FTheta::kName) return std::nullopt;
  std::vector<double> parameters = camera.parameters;
  if (behind_glass)
    parameters.erase(parameters.begin() + kFirstGlass, parameters.begin() + kFirstGlass + kGlass);
  FThetaIntrinsics lens;
  lens.angle_is_reference = inverse;
  lens.cx = camera.cx();
  lens.cy = camera.cy();
  lens.c = camera.fx() / camera.fy();
  lens.d = parameters[8] * lens.c;
  lens.e = parameters[9];
  const double focal_px = camera.fy(), unit = inverse ? 1 / focal_px : 1,
               first = inverse ? 1 / focal_px : focal_px;
  std::vector<double> reference{0, first};
  for (int i = 2; i < static_cast<int>(kCoefficients); ++i)
    reference.push_back(parameters[2 + i] * first * std::pow(unit, i - 1));
  const auto [max_angle_rad, max_radius_px] = [&] {
    const auto of = [&](const auto& model) {
      return std::pair(model.max_angle_rad, model.max_radius * focal_px);
    };
    return inverse ? of(FThetaInverse(std::span(parameters).subspan(4)))
                   : of(FTheta(std::span(parameters).subspan(4)));
  }();
  lens.max_angle_rad = max_angle_rad;
  const Eigen::VectorXd from =
      Eigen::VectorXd::LinSpaced(400, 0, inverse ? max_radius_px : max_angle_rad);
  const Eigen::VectorXd to = from.unaryExpr([&](double x) { return horner(reference, x); });
  std::vector<double> other = fit_polynomial(to, from);
  (inverse ? lens.pixeldist_to_angle : lens.angle_to_pixeldist) = std::move(reference);
  (inverse ? lens.angle_to_pixeldist : lens.pixeldist_to_angle) = std::move(other);
  return lens;
}

std::optional<WindshieldPolynomials> windshield_polynomials(const CameraCalibration& camera) {
  if (!has_windshield(camera)) return std::nullopt;
  const std::span<const double> terms = std::span(camera.parameters).subspan(kFirstGlass, kGlass);
  const WindshieldGlass glass(terms);
  WindshieldPolynomials out;
  out.horizontal.assign(terms.begin(), terms.begin() + kWindshieldTermsH);
  out.vertical.assign(terms.begin() + kWindshieldTermsH, terms.end());
  constexpr double kMost_rad = std::numbers::pi / 3;
  constexpr int kSteps = 20;
  const double reach = std::min(glass.reach_rad, kMost_rad);
  std::vector<Eigen::Vector2d> before, behind;
  for (int i = -kSteps; i <= kSteps; ++i)
    for (int j = -kSteps; j <= kSteps; ++j)
      if (std::abs(i) + std::abs(j) <= kSteps) {
        before.emplace_back(reach * i / kSteps, reach * j / kSteps);
        behind.push_back(glass.bend(before.back()));
      }
  const auto rows = Eigen::Map<const Eigen::Matrix2Xd>(before.front().data(), 2, before.size());
  out.horizontal_inverse = fit_bivariate(behind, rows.row(0), kWindshieldOrderH);
  out.vertical_inverse = fit_bivariate(behind, rows.row(1), kWindshieldOrderV);
  return out;
}

}  // namespace redrive
