// SPDX-License-Identifier: Apache-2.0
// OpenCV's distortion coefficients of a pinhole, which formats give whole, and the model that has
// those of them that are not 0.
#pragma once

#include <array>
#include <optional>

#include "redrive/camera/calibration.h"

namespace redrive {

/// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4.
using OpenCvCoefficients = std::array<double, 12>;

/// Sets the camera's model and its coefficients after fx, fy, cx, cy: opencv_pinhole,
/// opencv_rational or opencv_thin_prism, the one with the fewest.
void set_opencv_coefficients(const OpenCvCoefficients& coefficients, CameraCalibration* camera);

/// Returns the coefficients of a camera of these models, nothing of others.
std::optional<OpenCvCoefficients> opencv_coefficients(const CameraCalibration& camera);

}  // namespace redrive
