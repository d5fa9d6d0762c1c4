// SPDX-License-Identifier: Apache-2.0
// Camera models of NCore: ftheta, behind a windshield or not, opencv-pinhole, opencv-fisheye.
#pragma once

#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/recording/core/recording.h"

namespace redrive::ncore {

/// Sets model, parameters and size of a camera. `intrinsics`: attributes of a group of an
/// intrinsics component. A finding names a windshield that is not modelled: before another lens
/// than ftheta, or of higher order. InputError: another model, numbers out of range.
void parse_lens(const JsonField& intrinsics, CameraCalibration* camera,
                std::vector<Finding>* findings);

/// Direction of a rolling shutter: readout_by_column, and 1 or -1; 0: global. InputError for
/// another.
int parse_shutter(const JsonField& intrinsics, CameraCalibration* camera);

}  // namespace redrive::ncore
