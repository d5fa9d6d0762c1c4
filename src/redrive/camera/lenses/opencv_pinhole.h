// SPDX-License-Identifier: Apache-2.0
// "opencv_pinhole": the pinhole camera with OpenCV's five distortion coefficients.
//   (x, y) = (X/Z, Y/Z), then camera/lenses/brown_conrady.h.
#pragma once

#include <array>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/brown_conrady.h"

namespace redrive {

/// (x, y) = (X/Z, Y/Z), in front of the camera.
struct PerspectivePlane {
  template <class M, class Numbers>
  static REDRIVE_LANES PlanePoint<M> project(const Numbers&, typename M::Real x, typename M::Real y,
                                             typename M::Real z) {
    PlanePoint<M> p;
    p.scale = M::constant(1) / z;
    p.x = x * p.scale;
    p.y = y * p.scale;
    p.s = p.x * p.x + p.y * p.y;
    p.seen = z > M::constant(0);
    return p;
  }
  template <class M, class Numbers>
  static REDRIVE_LANES void adjoint(const Numbers&, typename M::Real, typename M::Real,
                                    typename M::Real, const PlanePoint<M>& p, typename M::Real d_x,
                                    typename M::Real d_y, typename M::Real* d_point) {
    d_x = d_x * p.scale;
    d_y = d_y * p.scale;
    d_point[0] = d_point[0] + d_x;
    d_point[1] = d_point[1] + d_y;
    d_point[2] = d_point[2] - (d_x * p.x + d_y * p.y);
  }
};

struct OpenCvPinhole {
  static constexpr const char* kName = "opencv_pinhole";
  static constexpr auto kDistortion = BrownConrady::kParameters;
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 5> kTransformsNames{
      "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL"};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 5> kTypical{-0.3, 0.08, 0.002, 0.0006, 0};

  using Plane = PerspectivePlane;
  using Radial = BrownConrady;
  template <class S>
  using Numbers = BrownConradyNumbers<S>;

  BrownConrady distortion;

  OpenCvPinhole() = default;
  /// k1 k2 p1 p2 k3, all finite.
  explicit OpenCvPinhole(std::span<const double> parameters) : distortion(parameters.first<5>()) {}

  const Numbers<double>& numbers() const { return distortion; }
  double max_plane_radius() const { return distortion.max_radius; }
  double covered_radius() const { return distortion.covered_radius(); }

  /// Returns the distorted normalised coordinates of a point (any length), or nothing behind the
  /// camera or beyond the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const std::optional<Eigen::Vector2d> m = distortion.undistort(distorted);
    if (!m) return std::nullopt;
    return Eigen::Vector3d(m->x(), m->y(), 1);
  }
};

}  // namespace redrive
