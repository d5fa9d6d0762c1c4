// SPDX-License-Identifier: Apache-2.0
// The camera and the time that the exposure and white balance of an image depend on.
#pragma once

namespace redrive {

struct Exposure {
  int camera = -1;  ///< index in the run's rig; -1: no gains, the field's own colours
  float t_s = 0;    ///< seconds since the first frame of the scene
};

}  // namespace redrive
