// SPDX-License-Identifier: Apache-2.0
// OpenCV's twelve distortion coefficients of a pinhole, and the smallest of three models that has
// all that are not 0. Only a header, since the server's module links no library.
#pragma once

#include <algorithm>
#include <array>
#include <optional>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_thin_prism.h"

namespace redrive {

/// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, without unit. Their range is the caller's to check
/// (CameraParameter); NaN is not 0.
using OpenCvCoefficients = std::array<double, OpenCvThinPrism::kDistortion.size()>;

namespace opencv_detail {

/// Sets the model where it has all coefficients that are not 0. Returns whether it has.
template <class Model>
bool set_model(const OpenCvCoefficients& coefficients, CameraCalibration* camera) {
  const auto end = coefficients.begin() + Model::kDistortion.size();
  if (std::any_of(end, coefficients.end(), [](double k) { return k != 0; })) return false;
  camera->model = Model::kName;
  camera->parameters.resize(4);
  camera->parameters.insert(camera->parameters.end(), coefficients.begin(), end);
  return true;
}

}  // namespace opencv_detail

/// Sets the camera's model and its coefficients after fx, fy, cx, cy: opencv_pinhole,
/// opencv_rational or opencv_thin_prism, the one with the fewest.
inline void set_opencv_coefficients(const OpenCvCoefficients& coefficients,
                                    CameraCalibration* camera) {
  opencv_detail::set_model<OpenCvPinhole>(coefficients, camera) ||
      opencv_detail::set_model<OpenCvRational>(coefficients, camera) ||
      opencv_detail::set_model<OpenCvThinPrism>(coefficients, camera);
}

/// Returns the coefficients of a camera of these models, nothing of others.
inline std::optional<OpenCvCoefficients> opencv_coefficients(const CameraCalibration& camera) {
  if (camera.model != OpenCvPinhole::kName && camera.model != OpenCvRational::kName &&
      camera.model != OpenCvThinPrism::kName)
    return std::nullopt;
  OpenCvCoefficients all{};
  for (std::size_t i = 4; i < camera.parameters.size(); ++i) all.at(i - 4) = camera.parameters[i];
  return all;
}

}  // namespace redrive
