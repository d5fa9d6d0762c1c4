// SPDX-License-Identifier: Apache-2.0
// "opencv_pinhole": the pinhole camera with OpenCV's five distortion coefficients.
//   (x, y) = (X/Z, Y/Z), then camera/brown_conrady.h.
#pragma once

#include <array>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/brown_conrady.h"
#include "redrive/camera/calibration.h"

namespace redrive {

struct OpenCvPinhole {
  static constexpr const char* kName = "opencv_pinhole";
  static constexpr auto kDistortion = BrownConrady::kParameters;
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 5> kTransformsNames{
      "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL"};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 5> kTypical{-0.3, 0.08, 0.002, 0.0006, 0};

  BrownConrady distortion;

  OpenCvPinhole() = default;
  /// k1 k2 p1 p2 k3, all finite.
  explicit OpenCvPinhole(std::span<const double> parameters) : distortion(parameters.first<5>()) {}

  double covered_radius() const { return distortion.covered_radius(); }

  /// Returns the distorted normalised coordinates of a point (any length), or nothing behind the
  /// camera or beyond the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    if (!(point[2] > T(0))) return std::nullopt;
    const std::array<T, 2> m{point[0] / point[2], point[1] / point[2]};
    // 1e-12: margin for rounding of a ray that unproject returned on the edge.
    if (!(m[0] * m[0] + m[1] * m[1] <=
          T(distortion.max_radius * distortion.max_radius * (1 + 1e-12))))
      return std::nullopt;
    return distortion.distort(m);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const std::optional<Eigen::Vector2d> m = distortion.undistort(distorted);
    if (!m) return std::nullopt;
    return Eigen::Vector3d(m->x(), m->y(), 1);
  }
};

}  // namespace redrive
