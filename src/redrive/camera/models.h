// SPDX-License-Identifier: Apache-2.0
// The registry of camera models.
//
// How to add a model:
// 1. camera/lenses/<model>.h: a plain struct on normalised coordinates (pixel = f x + c), like
// camera/lenses/mei.h:
//    - kName: its name in calibration files.
//    - kDistortion: coefficients in the order of "distortion_coeffs", may be none; kOther: further
//      parameters, each a field of its own ("xi"). Ranges are inclusive.
//    - kTransformsNames: values of "camera_model" in transforms.json that mean it; may be empty.
//    - kPerspective: straight lines stay straight once undistorted, so --undistort is possible.
//    - kImageCircle: images are black beyond a circle, which is masked.
//    - kTypical: parameters of a common lens, used by every test of camera_test.cc.
//    - a constructor from std::span<const double>: kDistortion, then kOther.
//    - covered_radius(): Camera::covered_radius.
//    - Plane, Radial and Numbers, of which camera/lenses/lens.h makes the projection and its
//    derivatives,
//      for numbers and vectors; numbers(), and max_plane_radius(), which ends the region where the
//      model is one-to-one. A further model often takes the Plane or the Radial of another.
//    - `template <class T> std::optional<std::array<T, 2>> project(const std::array<T, 3>& point)
//      const`, which returns project_point(*this, point), and
//      `std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d&) const`. Both return
//      nothing outside that region.
// 2. Its type in CameraModel below.
// 3. camera/lenses/<model>_test.cc: properties of this model alone.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/double_sphere.h"
#include "redrive/camera/lenses/eucm.h"
#include "redrive/camera/lenses/fov.h"
#include "redrive/camera/lenses/ftheta.h"
#include "redrive/camera/lenses/mei.h"
#include "redrive/camera/lenses/opencv_fisheye.h"
#include "redrive/camera/lenses/opencv_pinhole.h"
#include "redrive/camera/lenses/opencv_rational.h"
#include "redrive/camera/lenses/opencv_thin_prism.h"
#include "redrive/camera/lenses/thin_prism_fisheye.h"
#include "redrive/camera/lenses/windshield.h"

namespace redrive {

using CameraModel = std::variant<OpenCvPinhole, Mei, OpenCvFisheye, OpenCvRational, OpenCvThinPrism,
                                 Fov, ThinPrismFisheye, FTheta, FThetaInverse, DoubleSphere, Eucm,
                                 Windshield<FTheta>, Windshield<FThetaInverse>>;

/// A model's description, for readers and writers of calibrations.
struct CameraModelInfo {
  std::string_view name;
  std::span<const CameraParameter> distortion;  ///< parameters 4.. of CameraCalibration
  std::span<const CameraParameter> other;       ///< the parameters after them
  std::span<const std::string_view> transforms_names;
  std::span<const double> typical;  ///< typical values: distortion, then other
  bool perspective, image_circle;
  /// `parameters`: distortion, then other.
  CameraModel (*make)(std::span<const double> parameters);
};

/// All models, in the order of CameraModel.
std::span<const CameraModelInfo> camera_models();
/// The model of that name; null if there is none.
const CameraModelInfo* find_camera_model(std::string_view name);
/// "opencv_pinhole, mei, ...", for messages.
std::string camera_model_names();
/// The description of the model in `model`.
const CameraModelInfo& info_of(const CameraModel& model);

/// Distortion coefficients of a calibration whose model is known, in the model's order.
std::vector<double> distortion(const CameraCalibration& calibration);
/// Its other parameters with their names.
std::vector<std::pair<std::string, double>> other_parameters(const CameraCalibration& calibration);

}  // namespace redrive
