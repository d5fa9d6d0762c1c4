// SPDX-License-Identifier: Apache-2.0
// A camera: one model, exact in both directions for every pixel of the image as it was recorded.
// Each model is a plain struct templated on the scalar (camera/<model>.h):
//   template <class T> std::optional<...> — see pinhole.h for the two functions a model has to have.
// To add one: its header, a line in CameraModel below, a line in make_camera, and camera_test walks it.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include <Eigen/Core>

#include "redrive/camera/mei.h"
#include "redrive/camera/opencv_pinhole.h"
#include "redrive/recording/recording.h"

namespace redrive {

using CameraModel = std::variant<OpenCvPinhole, Mei>;

/// Intrinsics: model, focal lengths, principal point and image size, in pixels. Integer coordinates are centres.
struct Camera {
  CameraModel model;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;

  /// Pixel of a point in camera axes (x right, y down, z forward; any length > 0). Nothing where the model does not
  /// reach: behind a pinhole, or outside the radius up to which its distortion is one-to-one (beyond it the
  /// polynomial folds back and a second, wrong point would land in the image).
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point) const;

  /// Unit direction seen by a pixel (continuous coordinates); nothing outside the valid radius.
  /// project(unproject(p)) = p to 1e-6 px.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;

  /// The camera of the image that is `factor` times smaller (area-averaged, remainder rows and columns cut off):
  /// f/factor, (c + 1/2)/factor - 1/2, floor(size/factor).
  Camera downscaled(int factor) const;

  /// The pinhole without distortion that the image belongs to once undistorted (the report's way): same f and c.
  Camera undistorted() const;

  const char* model_name() const;  ///< "opencv_pinhole", "mei"
};

Camera make_camera(const CameraCalibration& calibration);

}  // namespace redrive
