// SPDX-License-Identifier: Apache-2.0
// --rolling-shutter of train and align: how long cameras take to read their rows, where the
// calibration does not say.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/recording.h"

namespace redrive {

/// Puts what is given in the place of CameraCalibration::readout_ns: "MS" for all cameras, "CAM:MS"
/// for one; "estimate" and "CAM:estimate" leave the calibration's as what align starts from. Of
/// several that mean a camera the last one counts. By camera: whether its readout is to be
/// estimated. UsageError: no number, beyond kMaxReadout_s, a camera that the recording lacks.
std::vector<bool> apply_readout_options(const std::vector<std::string>& given,
                                        Recording* recording);

/// Whether one of them is to be estimated.
bool estimates_readouts(const std::vector<std::string>& given);

}  // namespace redrive
