// SPDX-License-Identifier: Apache-2.0
// Calibration of one camera as a file gives it: model, intrinsics as a vector in the model's order
// (COLMAP's Camera::params), extrinsics and times. camera/camera.h makes a Camera out of it.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive {

/// Longest readout of a rolling shutter, in either direction.
constexpr double kMaxReadout_s = 0.2;

/// Name and accepted range of one parameter of a camera model.
struct CameraParameter {
  std::string_view name;
  double min = -1e6, max = 1e6;  ///< r^6 terms beyond leave the range of float at 45 degrees
};

struct CameraCalibration {
  std::string name;
  std::string model;  ///< CameraModelInfo::name (camera/models.h)
  /// fx, fy, cx, cy in pixels (integer coordinates are pixel centres, as in OpenCV), then the
  /// model's distortion coefficients, then its other parameters.
  std::vector<double> parameters;
  int width = 0, height = 0;  ///< pixels
  /// Extrinsics. Camera axes: x right, y down, z forward; body axes: x forward, y left, z up.
  Rigid3d body_from_sensor;
  std::int64_t time_offset_ns = 0;  ///< exposure of the middle line minus the time of the frame
  /// Rolling shutter: row v is exposed ((v + 1/2) / height - 1/2) readout_ns after the middle row.
  /// Negative: read from the lowest row up.
  std::int64_t readout_ns = 0;
  /// A rolling shutter exposes columns instead: column u ((u + 1/2) / width - 1/2) readout_ns after
  /// the middle column.
  bool readout_by_column = false;

  double fx() const { return parameters.at(0); }
  double fy() const { return parameters.at(1); }
  double cx() const { return parameters.at(2); }
  double cy() const { return parameters.at(3); }
};

}  // namespace redrive
