// SPDX-License-Identifier: Apache-2.0
// The pinhole camera with OpenCV's five distortion coefficients ("opencv_pinhole"):
//   (x, y) = (X/Z, Y/Z), then camera/brown_conrady.h.
#pragma once

#include <array>
#include <optional>

#include <Eigen/Core>

#include "redrive/camera/brown_conrady.h"

namespace redrive {

struct OpenCvPinhole {
  static constexpr const char* kName = "opencv_pinhole";
  BrownConrady distortion;

  /// Distorted normalised coordinates of a point (any length). Nothing behind the camera or beyond
  /// the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    if (!(point[2] > T(0))) return std::nullopt;
    const std::array<T, 2> m{point[0] / point[2], point[1] / point[2]};
    // 1e-12: room for the rounding of a ray that unproject has found on the edge itself.
    if (!(m[0] * m[0] + m[1] * m[1] <=
          T(distortion.max_radius * distortion.max_radius * (1 + 1e-12))))
      return std::nullopt;
    return distortion.distort(m);
  }

  /// Direction (not normalised) that is projected to `distorted`; nothing if there is none.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const std::optional<Eigen::Vector2d> m = distortion.undistort(distorted);
    if (!m) return std::nullopt;
    return Eigen::Vector3d(m->x(), m->y(), 1);
  }
};

}  // namespace redrive
