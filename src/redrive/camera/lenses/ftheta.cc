// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/ftheta.h"

#include <algorithm>

#include <Eigen/QR>
#include <Eigen/SVD>

#include "redrive/base/error.h"
#include "redrive/camera/lenses/lens.h"
#include "redrive/camera/lenses/roots.h"
#include "redrive/camera/models.h"

namespace redrive {
namespace {

using Math = NumberMath<double>;
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

}  // namespace

FThetaLens::FThetaLens(std::span<const double> c)
    : Numbers<double>{c[0], c[1], c[2], c[3], c[4], c[5], 0},
      max_angle_rad(std::min(c[6], std::numbers::pi * (1 - 1e-9))) {}

double FThetaLens::increases_to(double end) const {
  const std::vector<double> folds =
      sign_changes({1 - kLeastSlope, 2 * k2, 3 * k3, 4 * k4, 5 * k5}, end);
  return folds.empty() ? end : folds.front();
}

// The shear shortens lengths at most by its least singular value.
double FThetaLens::covered_radius() const {
  Eigen::Matrix2d shear;
  shear << 1, shear_x, shear_y, 1;
  return max_radius * shear.jacobiSvd().singularValues().minCoeff();
}

FTheta::FTheta(std::span<const double> c) : FThetaLens(c) {
  max_angle_rad = increases_to(max_angle_rad);
  max_radius = polynomial<Math>(numbers(), max_angle_rad).value;
}

std::optional<Eigen::Vector3d> FTheta::unproject(const Eigen::Vector2d& distorted) const {
  return direction(distorted, [&](double r) {
    return increasing_root([&](double a) { return polynomial<Math>(numbers(), a).value; },
                           [&](double a) { return polynomial<Math>(numbers(), a).slope; }, r, r,
                           max_angle_rad);
  });
}

FThetaInverse::FThetaInverse(std::span<const double> c) : FThetaLens(c) {
  const auto angle = [&](double r) { return polynomial<Math>(numbers(), r).value; };
  const double end = increases_to(4 * max_angle_rad);
  max_angle_rad = std::min(max_angle_rad, angle(end));
  max_radius = increasing_root(
      angle, [&](double r) { return polynomial<Math>(numbers(), r).slope; }, max_angle_rad,
      max_angle_rad, end);
}

std::optional<Eigen::Vector3d> FThetaInverse::unproject(const Eigen::Vector2d& distorted) const {
  return direction(distorted, [&](double r) {
    return std::min(polynomial<Math>(numbers(), r).value, max_angle_rad);
  });
}

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
  const CameraModelInfo& info = *find_camera_model(camera->model);
  for (std::size_t i = 4; i < camera->parameters.size(); ++i) {
    const std::size_t other = i - 4 - info.distortion.size();
    const CameraParameter& p =
        i - 4 < info.distortion.size() ? info.distortion[i - 4] : info.other[other];
    if (!(camera->parameters[i] >= p.min && camera->parameters[i] <= p.max))
      refuse(std::string(p.name), std::to_string(camera->parameters[i]), "is out of range");
  }
}

std::optional<FThetaIntrinsics> ftheta_intrinsics(const CameraCalibration& camera) {
  const bool inverse = camera.model == FThetaInverse::kName;
  if (!inverse && camera.model != FTheta::kName) return std::nullopt;
  const std::span<const double> parameters = camera.parameters;
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
    return inverse ? of(FThetaInverse(parameters.subspan(4))) : of(FTheta(parameters.subspan(4)));
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

}  // namespace redrive
