// SPDX-License-Identifier: Apache-2.0
// How much of an image its camera model has directions for.
#pragma once

#include "redrive/camera/camera.h"

namespace redrive {

/// Per cent of the pixels outside the model's valid region, on a grid of `columns`. A circular
/// fisheye in a wide image has up to 60 of them.
double percent_without_ray(const Camera& camera, int columns = 160);

/// Percentages above which a calibration is refused, and above which it gets a warning.
inline constexpr double kMostWithoutRay = 90, kMuchWithoutRay = 50;

/// "99.5 % of the pixels lie outside the radius where the distortion is one-to-one".
std::string without_ray_text(double percent);

}  // namespace redrive
