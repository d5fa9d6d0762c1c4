// SPDX-License-Identifier: Apache-2.0
// A camera: one model, exact in both directions for every pixel of the image as it was recorded.
// camera/models.h tells how to add a model.
#pragma once

#include <optional>
#include <string>

#include <Eigen/Core>

#include "redrive/camera/models.h"

namespace redrive {

/// Intrinsics: model, focal lengths, principal point and image size, in pixels. Integer coordinates
/// are centres.
struct Camera {
  CameraModel model;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;

  /// Pixel of a point in camera axes (x right, y down, z forward; any length > 0). Nothing where
  /// the model does not reach: behind a pinhole, or outside the radius up to which its distortion
  /// is one-to-one (beyond it the polynomial folds back and a second, wrong point would land in the
  /// image).
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point) const;

  /// Unit direction seen by a pixel (continuous coordinates); nothing outside the valid radius.
  /// project(unproject(p)) = p to 1e-6 px.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;

  /// The camera of the image that is `factor` times smaller (area-averaged, remainder rows and
  /// columns cut off): f/factor, (c + 1/2)/factor - 1/2, floor(size/factor).
  Camera downscaled(int factor) const;

  /// The pinhole without distortion that the image belongs to once undistorted (the report's way):
  /// same f and c.
  Camera undistorted() const;

  const CameraModelInfo& info() const { return info_of(model); }

  /// Distance from the principal point in normalised coordinates, ((u - cx) / fx, (v - cy) / fy),
  /// within which every pixel has a direction; infinity if all have.
  double covered_radius() const;
};

/// InputError for an unknown model.
Camera make_camera(const CameraCalibration& calibration);

}  // namespace redrive
