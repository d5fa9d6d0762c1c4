// SPDX-License-Identifier: Apache-2.0
// A camera: projection and unprojection, both exact, for every pixel of the recorded image.
// camera/models.h describes how to add a model.
#pragma once

#include <optional>
#include <string>

#include <Eigen/Core>

#include "redrive/camera/models.h"

namespace redrive {

/// Intrinsics: model, focal lengths, principal point and image size, in pixels. Integer coordinates
/// are pixel centres.
struct Camera {
  CameraModel model;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;

  /// Returns the pixel of a point in camera axes (x right, y down, z forward; any length > 0), or
  /// nothing outside the model's valid region: behind a pinhole, or beyond the radius up to which
  /// the distortion is one-to-one. Further out the polynomial folds back, and a second, wrong point
  /// would land in the image.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point) const;

  /// Returns the unit direction of a pixel (continuous coordinates), or nothing outside the valid
  /// region. project(unproject(p)) = p to 1e-6 px.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;

  /// Returns the camera of an image downscaled by area averaging, without the remaining rows and
  /// columns: f / factor, (c + 1/2) / factor - 1/2, floor(size / factor).
  Camera downscaled(int factor) const;

  /// Returns the pinhole without distortion, of the same f and c, of the undistorted image. The
  /// model must be a perspective one.
  Camera undistorted() const;

  const CameraModelInfo& info() const { return info_of(model); }

  /// Distance from the principal point in normalised coordinates, ((u - cx) / fx, (v - cy) / fy),
  /// within which every pixel has a direction; infinity if all have.
  double covered_radius() const;
};

/// InputError for an unknown model.
Camera make_camera(const CameraCalibration& calibration);

}  // namespace redrive
