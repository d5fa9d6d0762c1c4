// SPDX-License-Identifier: Apache-2.0
// F-theta lenses and windshields as NVIDIA's files and services give them (NCore's
// FThetaCameraModelParameters and BivariateWindshieldModelParameters).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/camera/calibration.h"

namespace redrive {

/// Both polynomials of an f-theta lens, ascending, r in pixels; the reference is the exact one.
/// u = c x + d y + cx, v = e x + y + cy with (x, y) in pixels from the principal point, which
/// counts from the centre of the first pixel.
struct FThetaIntrinsics {
  double cx = 0, cy = 0;
  bool angle_is_reference = false;                             ///< pixeldist_to_angle is
  std::vector<double> pixeldist_to_angle, angle_to_pixeldist;  ///< at most 6 coefficients each
  double max_angle_rad = 0;                                    ///< 0: not given
  double c = 1, d = 0, e = 0;
};

/// The glass before a lens: polynomials of camera/lenses/windshield.h, the terms in its order. The
/// first pair leads from the world to the lens, the inverse pair back, approximately. (NCore's
/// reference_poly says which of the pairs is the exact one.)
struct WindshieldPolynomials {
  std::vector<double> horizontal, vertical, horizontal_inverse, vertical_inverse;
};

/// Sets model and parameters of a camera. Of the polynomials the reference alone is looked at.
/// InputError, with `file` and `field` before the part's name, for a polynomial of more than 6
/// coefficients, one that is not 0 at 0 or does not increase there, and parameters out of range.
void set_ftheta(const FThetaIntrinsics& lens, const std::string& file, const std::string& field,
                CameraCalibration* camera);

/// Puts a windshield before a camera of set_ftheta. Of the polynomials the first pair alone is
/// looked at. InputError, with `file` and `field` before the part's name: polynomials of other than
/// 1, 3 or 6 (horizontal) and 1, 3, 6, 10 or 15 (vertical) coefficients, a glass that is not
/// one-to-one ahead.
void set_windshield(const WindshieldPolynomials& glass, const std::string& file,
                    const std::string& field, CameraCalibration* camera);

/// The inverse of set_ftheta; the polynomial that is not the reference is a least-squares fit over
/// the valid region. Nothing for cameras of other models. A windshield is left out.
std::optional<FThetaIntrinsics> ftheta_intrinsics(const CameraCalibration& camera);

/// The inverse of set_windshield; the inverse pair is a least-squares fit within 60 degrees, or as
/// far as the glass reaches. Nothing for cameras without one.
std::optional<WindshieldPolynomials> windshield_polynomials(const CameraCalibration& camera);

}  // namespace redrive
