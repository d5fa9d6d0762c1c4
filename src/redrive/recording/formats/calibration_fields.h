// SPDX-License-Identifier: Apache-2.0
// Intrinsics from JSON, under any format's names. Each function reads one number; InputError if no
// camera can have it.
#pragma once

#include "redrive/base/json_field.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

constexpr std::int64_t kMaxPixels = 1 << 28;  ///< sixteen times the largest automotive sensors
constexpr double kMaxImageSize_px = 65536;
constexpr double kMaxFocalLength_px = 1e6;  ///< 65536 px across 4 degrees

/// Whole pixels, 1 to 65536 a side, 2^28 in all.
void image_size_from_json(const JsonField& width, const JsonField& height,
                          CameraCalibration* camera);
double focal_length_from_json(const JsonField& field);  ///< pixels, above 0, at most 1e6
double principal_point_from_json(const JsonField& field,
                                 int size);  ///< pixels, at most one image size outside the image
/// A parameter of the camera model, within its range.
double parameter_from_json(const JsonField& field, const CameraParameter& parameter);

}  // namespace redrive
