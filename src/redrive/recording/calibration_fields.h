// SPDX-License-Identifier: Apache-2.0
// Intrinsics from JSON, whatever the format calls them. Each function reads one number; InputError
// if no camera has it.
#pragma once

#include "redrive/base/json_field.h"
#include "redrive/recording/recording.h"

namespace redrive {

/// Whole pixels, 1 to 65536 a side, 2^28 in all.
void image_size_from_json(const JsonField& width, const JsonField& height,
                          CameraCalibration* camera);
double focal_length_from_json(const JsonField& field);  ///< pixels, above 0, at most 1e6
double principal_point_from_json(const JsonField& field,
                                 int size);  ///< pixels, at most one image size outside the image
/// A parameter of the camera model, within its range.
double parameter_from_json(const JsonField& field, const CameraParameter& parameter);

}  // namespace redrive
