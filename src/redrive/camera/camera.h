// SPDX-License-Identifier: Apache-2.0
// A camera: one model, exact in both directions for every pixel of the image as it was recorded.
//
// How to add a model:
// 1. camera/<model>.h: a plain struct on normalised coordinates (no focal lengths) with kName (its
// name in calibration
//    files), `template <class T> std::optional<std::array<T, 2>> project(const std::array<T, 3>&
//    point) const`, which also works on dual numbers (math/dual.h), and
//    `std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d&) const`. Both say nothing
//    beyond the region where the model is one-to-one.
// 2. Its type in CameraModel below, a line in make_camera, and its fields in the recording's
// parser.
// 3. An example in camera_test.cc: every test there walks the list.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include <Eigen/Core>

#include "redrive/camera/mei.h"
#include "redrive/camera/opencv_fisheye.h"
#include "redrive/camera/opencv_pinhole.h"
#include "redrive/recording/recording.h"

namespace redrive {

using CameraModel = std::variant<OpenCvPinhole, Mei, OpenCvFisheye>;

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

  const char* model_name() const;  ///< "opencv_pinhole", "mei", "opencv_fisheye"
};

Camera make_camera(const CameraCalibration& calibration);

}  // namespace redrive
