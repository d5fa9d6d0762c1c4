// SPDX-License-Identifier: Apache-2.0
// --rolling-shutter of train and align: readout times of cameras, which replace the calibration's.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Sets CameraCalibration::readout_ns: "MS" for all cameras, "CAM:MS" for one. "estimate" and
/// "CAM:estimate" keep the calibration's value as the initial one of align. The last option that
/// names a camera counts. Returns by camera whether to estimate its readout. UsageError: not a
/// number, beyond kMaxReadout_s, unknown camera.
std::vector<bool> apply_readout_options(const std::vector<std::string>& options,
                                        Recording* recording);

/// Whether to estimate the readout of any camera.
bool estimates_readouts(const std::vector<std::string>& options);

}  // namespace redrive
