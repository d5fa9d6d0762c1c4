// SPDX-License-Identifier: Apache-2.0
// By which camera a picture is taken and when: what its exposure and white balance depend on.
#pragma once

namespace redrive {

struct Exposure {
  int camera = -1;  ///< of the run's rig; -1: none of them, as the field itself looks
  float t_s = 0;    ///< since the first frame of the scene
};

}  // namespace redrive
