// SPDX-License-Identifier: Apache-2.0
// calibration.json: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/calibration_json.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    redrive::OtherSensors others;
    for (const redrive::CameraCalibration& camera :
         redrive::parse_calibration(text, "calibration.json", &others)) {
      if (!camera.body_from_sensor.matrix().allFinite()) __builtin_trap();
    }
    if (others.body_from_lidar && !others.body_from_lidar->matrix().allFinite()) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
