// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/recording.h"

namespace redrive {

const RecordedCamera* Recording::find_camera(const std::string& name) const {
  for (const RecordedCamera& camera : cameras) {
    if (camera.calibration.name == name) return &camera;
  }
  return nullptr;
}

}  // namespace redrive
